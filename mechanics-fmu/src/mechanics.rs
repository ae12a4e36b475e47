//! The mechanical problem in time.
//!
//! - `state`: states, and whether they belong to a mesh.
//! - `partner`: pressures as the partner gives them.
//! - `loads`: loads and prescribed displacements.
//! - `step`: time steps, and `energy`: their energy balance.
//! - `response`: linearised responses of a state.
//! - `results`: what else follows from a state, and `scalars`: what sums it up.

mod energy;
mod loads;
mod partner;
mod response;
mod results;
mod scalars;
mod state;
mod step;

use std::borrow::Cow;
use std::sync::Arc;

use linear::{Forward, Scratch};
use mesh::Mesh;

use crate::contact::{ContactState, Face, Local};
use crate::error::{MechanicsError, ModelProblem};
use crate::linearised::Schur;
use crate::model::Model;
use crate::newton::{FractureProblem, SingularFracture};
use crate::space::Space;
use crate::system::{CellMaterial, SetupReport, Stage, System, Work};

pub use energy::Energy;
pub use partner::{Partner, PartnerResponse};
pub use response::Response;
pub use scalars::Scalars;
pub(crate) use state::History;
pub use state::State;
pub use step::{Discard, Outcome, StepReport, StepTimes};

/// Work space of solves.
#[derive(Default)]
struct Buffers {
    forward: Forward,
    scratch: Scratch,
}

/// Static contact mechanics of a fractured rock.
pub struct Mechanics {
    mesh: Arc<Mesh>,
    model: Model,
    system: System,
    faces: Vec<Face>,
    /// The S of the present factorisation, empty for 0; `None` where factorising failed.
    factorised_for: Option<Vec<f64>>,
    buffers: Buffers,
}

impl Mechanics {
    /// Checks the model against the mesh, assembles and factorises.
    ///
    /// # Errors
    /// [`MechanicsError::Model`] with all that is wrong with the model; [`MechanicsError::Linear`] if the stiffness cannot
    /// be factorised.
    pub fn new(mesh: Arc<Mesh>, model: Model) -> Result<Self, MechanicsError> {
        Self::watched(mesh, model, &mut |_| {})
    }

    /// As [`new`](Self::new); `ended` is told when each stage has.
    ///
    /// # Errors
    /// As there.
    pub fn watched(mesh: Arc<Mesh>, model: Model, ended: &mut dyn FnMut(Stage)) -> Result<Self, MechanicsError> {
        let mut problems = model.problems(&mesh);
        let network = mesh.network();
        let geometry = mesh.geometry();
        let mut apertures = Vec::new();
        for (&face, &fracture) in network.faces.iter().zip(&network.fracture) {
            let name = &mesh.data().fractures[fracture];
            let Some(law) = model.fractures.get(name) else { continue };
            let p = geometry.face_center[face];
            let aperture = (law.contact_aperture)(p, 0.0);
            law.check_aperture(aperture, |ok, what, value, allowed| {
                if !ok {
                    let what = format!("{what} of fracture \"{name}\"");
                    let (x, y, z) = (p.x, p.y, p.z);
                    problems.push(ModelProblem::Function { what, x, y, z, time: 0.0, value, allowed });
                }
            });
            apertures.push((law, aperture));
        }
        if !problems.is_empty() {
            return Err(MechanicsError::Model(problems));
        }
        let system = System::new(&mesh, &model, ended)?;
        let d = mesh.dim();
        let faces = (apertures.iter().zip(&network.faces).enumerate())
            .map(|(i, (&(law, aperture), &face))| {
                let measure = geometry.face_measure[face];
                let local = (0..d).map(|c| f64::from(system.schur.get(i * d + c, i * d + c))).sum::<f64>() / d as f64;
                Face::new(law, measure, local / measure, model.newton.beta_factor, aperture)
            })
            .collect();
        Ok(Self { mesh, model, system, faces, factorised_for: Some(Vec::new()), buffers: Buffers::default() })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// The unknowns.
    pub fn space(&self) -> &Space {
        &self.system.space
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Number of factorisations of the bulk so far: one, and one more for each change of the partner's matrix stiffness.
    pub fn factorisations(&self) -> usize {
        self.system.work.factorisations
    }

    /// Work done since the mechanics were made.
    pub fn work(&self) -> Work {
        self.system.work
    }

    /// What the set-up took and made.
    pub fn setup(&self) -> &SetupReport {
        &self.system.setup
    }

    fn fracture_problem<'a, 'f>(
        &'a self,
        faces: &'f [Face],
        add_product: &'a (dyn Fn(&[f64], &mut [f64]) + Sync),
    ) -> FractureProblem<'a, 'f> {
        FractureProblem {
            dim: self.mesh.dim(),
            schur: Schur { single: &self.system.schur, inverse: self.system.inverse.as_ref(), add_product },
            faces,
            settings: self.model.newton,
        }
    }

    /// The laws by which a state was found.
    fn faces_of(&self, state: &State) -> Cow<'_, [Face]> {
        self.faces_by(state.history.fading, state.history.dilates)
    }

    /// The faces with bounds that fade (λ_0 as a part of them) or not, and with dilation or without.
    fn faces_by(&self, fading: Option<f64>, dilates: bool) -> Cow<'_, [Face]> {
        let with = |face: &Face| {
            let opening = if dilates { face.opening } else { face.opening.without() };
            Face { opening, ..face.altered(fading, 1.0) }
        };
        match (fading, dilates) {
            (None, true) => Cow::Borrowed(&self.faces),
            _ => Cow::Owned(self.faces.iter().map(with).collect()),
        }
    }

    fn normal_jump(&self, face: usize) -> usize {
        self.system.space.first_jump_unknown() + face * self.mesh.dim()
    }

    fn local(&self, v: &[f64], face: usize) -> Local {
        let d = self.mesh.dim();
        let mut out = [0.0; 3];
        out[..d].copy_from_slice(&v[face * d..][..d]);
        out
    }

    fn material(&self, cell: usize) -> &CellMaterial {
        &self.system.materials[self.mesh.data().cell_region[cell]]
    }
}

/// Many short products, each of which would else be handed over to a thread of the pool and back.
fn on_the_pool<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    rayon::join(f, || ()).0
}

fn singular(SingularFracture(states): SingularFracture) -> MechanicsError {
    let [open, slipping] = [ContactState::Open, ContactState::Slip].map(|wanted| count(&states, wanted));
    MechanicsError::Singular { open, slipping }
}

fn count(states: &[ContactState], wanted: ContactState) -> usize {
    states.iter().filter(|&&s| s == wanted).count()
}
