//! What can be wrong with a model that every table of it allows.

use mesh::{Mesh, Vec3};

use crate::description::{
    Acceleration, Coupling, Criterion, Dilation, Fracture, Friction, MeshSource, Region, Time, Well,
};
use crate::document::quote;
use crate::expression::{Function, Node, Scope, parse};
use crate::value::compile;
use crate::{ExpressionError, Model, Number, TipDistances, Value};

/// Names of the fields that the two units exchange.
pub const FIELDS: [&str; 4] = ["matrix.pressure", "fracture.pressure", "matrix.porosity_change", "fracture.aperture"];

/// No mesh that one machine can use has more.
pub(crate) const MOST_CELLS: usize = 20_000_000;
/// No run makes more: at a millisecond each that would be three hours.
const MOST_TIME_STEPS: f64 = 1e7;
/// Smaller steps, as a part of the time, are lost in its round-off.
const LEAST_OF_TIME: f64 = 1e-9;

/// Problems as path of the key and message.
#[derive(Default)]
struct Log(Vec<(String, String)>);

impl Log {
    fn add(&mut self, key: impl Into<String>, message: impl Into<String>) {
        self.0.push((key.into(), message.into()));
    }

    fn number(&mut self, key: String, value: impl Into<Option<Number>>, ok: impl Fn(f64) -> bool, allowed: &str) {
        if let Some(Number(value)) = value.into()
            && !ok(value)
        {
            self.add(key, format!("{value} is out of range; it must be {allowed}"));
        }
    }

    fn positive(&mut self, key: String, value: impl Into<Option<Number>>) {
        self.number(key, value, |v| v > 0.0, "positive");
    }

    fn not_negative(&mut self, key: String, value: impl Into<Option<Number>>) {
        self.number(key, value, |v| v >= 0.0, "at least 0");
    }
}

impl Model {
    /// Dimension of the mesh, where the description tells it.
    pub fn dim(&self) -> Option<usize> {
        let mesh = &self.mesh;
        match (&mesh.cartesian, &mesh.triangles, &mesh.corner_point) {
            _ if mesh.extrude.is_some() => Some(3),
            (Some(b), ..) => Some(b.low.0.len()),
            (None, Some(_), _) => Some(2),
            (None, None, Some(grid)) => Some(if grid.section { 2 } else { 3 }),
            (None, None, None) => None,
        }
    }

    /// Makes a value ready to be evaluated.
    ///
    /// # Errors
    /// An expression that is not sound, or uses what `scope` does not have.
    pub fn function(&self, value: &Value, scope: Scope) -> Result<Function, ExpressionError> {
        compile(&self.define, value, scope, &mut Vec::new())
    }

    /// An expression of all variables, of what is under `[define]` and of further `names`, whose values
    /// [`Function::with`] is given in this order.
    ///
    /// # Errors
    /// An expression that is not sound, or has a name without a meaning.
    pub fn formula(&self, text: &str, names: &[String]) -> Result<Function, ExpressionError> {
        parse(text, Scope::All, &mut |name| {
            if let Some(i) = names.iter().position(|n| n == name) {
                return Some(Ok(Node::Given(i)));
            }
            let meaning = compile(&self.define, self.define.get(name)?, Scope::All, &mut vec![name.to_owned()]);
            Some(meaning.map(Node::from).map_err(|error| format!("in \"{name}\": {}", error.message)))
        })
    }

    /// All that can be told without a mesh.
    pub(crate) fn problems(&self) -> Vec<(String, String)> {
        let mut log = Log::default();
        for (key, value, scope) in self.values() {
            match self.function(value, scope) {
                Err(error) => log.add(key, error.to_string()),
                Ok(function) => {
                    if function.as_constant().is_some_and(|v| !v.is_finite()) {
                        log.add(key, "the value is not finite");
                    }
                }
            }
        }
        // A definition may use more than one place offers; what is wrong everywhere is reported once, here.
        for (name, value) in &self.define {
            let key = format!("define.{}", quote(name));
            let somewhere = [Scope::Boundary, Scope::Fracture];
            let errors: Vec<_> = somewhere.iter().filter_map(|&s| self.function(value, s).err()).collect();
            if errors.len() == somewhere.len() {
                log.add(key.clone(), errors[0].to_string());
            }
            if parse(name, Scope::Boundary, &mut |_| Some(Ok(Node::Number(1.0)))).is_err()
                || parse(name, Scope::Constant, &mut |_| None).is_ok()
                || parse(name, Scope::Boundary, &mut |_| None).is_ok()
                || parse(name, Scope::Fracture, &mut |_| None).is_ok()
            {
                log.add(key, "this name cannot be defined: it is no name, or has a meaning already");
            }
        }
        check_mesh_source(&self.mesh, &mut log);
        if self.unit_names().is_empty() {
            log.add("", "[mechanics] or [flow] is required");
        }
        for (name, region) in &self.regions {
            self.check_region(&format!("regions.{}", quote(name)), region, &mut log);
        }
        for (name, fracture) in &self.fractures {
            self.check_fracture(&format!("fractures.{}", quote(name)), fracture, &mut log);
        }
        self.check_mechanics(&mut log);
        self.check_flow(&mut log);
        self.dim().into_iter().for_each(|dim| self.check_dimension(dim, &mut log));
        check_time(&self.time, &mut log);
        check_coupling(&self.coupling, &mut log);
        self.check_connections(&mut log);
        let (start, end) = (self.time.start.0, self.time.end.0);
        let outside = self.output.times.iter().filter(|t| !(start..=end).contains(&t.0));
        let outside: Vec<String> = outside.map(|t| t.0.to_string()).collect();
        if !outside.is_empty() {
            let outside = outside.join(", ");
            let message = format!(
                "not within time.start and time.end, {start} to {end} s: {outside}; [] writes fields after every time step"
            );
            log.add("output.times", message);
        }
        log.0
    }

    /// All expressions: path of their key, and what they may depend on.
    fn values(&self) -> Vec<(String, &Value, Scope)> {
        let mut list = Vec::new();
        let mut add = |key: String, value, scope| list.push((key, value, scope));
        let marks = [("fractures", &self.mesh.fractures), ("regions", &self.mesh.regions), ("tags", &self.mesh.tags)];
        for (kind, marks) in marks {
            marks.iter().for_each(|(n, v)| add(format!("mesh.{kind}.{}", quote(n)), v, Scope::Place));
        }
        if let Some(limit) = self.mesh.triangles.as_ref().and_then(|t| t.size_limit.as_ref()) {
            add("mesh.triangles.size_limit".into(), limit, Scope::Place);
        }
        for (name, fracture) in &self.fractures {
            add(format!("fractures.{}.contact_aperture", quote(name)), &fracture.contact_aperture, Scope::Fracture);
        }
        add("initial.pressure".into(), &self.initial.pressure, Scope::Place);
        if let Some(mechanics) = &self.mechanics {
            for (i, entry) in mechanics.displacement.iter().enumerate() {
                entry.components().for_each(|(_, key, value)| {
                    add(format!("mechanics.displacement.{i}.{key}"), value, Scope::Boundary);
                });
            }
            for (i, entry) in mechanics.traction.iter().enumerate() {
                entry.components().for_each(|(_, key, value)| {
                    add(format!("mechanics.traction.{i}.{key}"), value, Scope::PlaceAndTime);
                });
            }
            for (i, value) in mechanics.body_force.iter().flatten().enumerate() {
                add(format!("mechanics.body_force.{i}"), value, Scope::PlaceAndTime);
            }
        }
        if let Some(flow) = &self.flow {
            for (tag, b) in &flow.boundary {
                let values =
                    [("pressure", &b.pressure), ("inflow", &b.inflow), ("fracture_inflow", &b.fracture_inflow)];
                for (key, value) in values {
                    if let Some(value) = value {
                        add(format!("flow.boundary.{}.{key}", quote(tag)), value, Scope::PlaceAndTime);
                    }
                }
            }
            let sources = [("matrix_source", &flow.matrix_source), ("fracture_source", &flow.fracture_source)];
            for (key, value) in sources {
                if let Some(value) = value {
                    add(format!("flow.{key}"), value, Scope::PlaceAndTime);
                }
            }
        }
        list
    }

    fn check_region(&self, key: &str, region: &Region, log: &mut Log) {
        log.positive(format!("{key}.young_modulus"), region.young_modulus);
        let nu = |v| v > -1.0 && v < 0.5;
        log.number(format!("{key}.poisson_ratio"), region.poisson_ratio, nu, "between −1 and 0.5, both excluded");
        let part = |v: f64| (0.0..=1.0).contains(&v);
        log.number(format!("{key}.biot_coefficient"), region.biot_coefficient, part, "in 0..1");
        log.number(format!("{key}.porosity"), region.porosity, |v| (0.0..1.0).contains(&v), "at least 0 and below 1");
        log.positive(format!("{key}.biot_modulus"), region.biot_modulus);
        let mut needed = |there: bool, unit: bool, name: &str, by: &str| {
            if unit && !there {
                log.add(format!("{key}.{name}"), format!("this key is required: there is a [{by}]"));
            }
        };
        let (mechanics, flow) = (self.mechanics.is_some(), self.flow.is_some());
        needed(region.young_modulus.is_some(), mechanics, "young_modulus", "mechanics");
        needed(region.poisson_ratio.is_some(), mechanics, "poisson_ratio", "mechanics");
        needed(region.permeability.is_some(), flow, "permeability", "flow");
    }

    fn check_fracture(&self, key: &str, fracture: &Fracture, log: &mut Log) {
        match fracture.friction {
            Friction::None => {}
            Friction::Tresca { bound } => log.not_negative(format!("{key}.friction.tresca.bound"), bound),
            Friction::Coulomb { coefficient, cohesion } => {
                log.not_negative(format!("{key}.friction.coulomb.coefficient"), coefficient);
                log.not_negative(format!("{key}.friction.coulomb.cohesion"), cohesion);
            }
        }
        let right = std::f64::consts::FRAC_PI_2;
        let angle = |v: f64| (0.0..right).contains(&v);
        log.number(
            format!("{key}.dilation_angle"),
            fracture.dilation_angle,
            angle,
            "in radians, at least 0, below π/2",
        );
        if fracture.dilation == Dilation::Mechanical {
            let coefficient = match fracture.friction {
                Friction::Coulomb { coefficient, .. } => coefficient.0,
                Friction::None | Friction::Tresca { .. } => 0.0,
            };
            let tangent = fracture.dilation_angle.0.tan();
            if tangent > coefficient {
                let message = format!(
                    "mechanical dilation by tan ψ = {tangent:.4} needs coulomb friction with a coefficient of at least as much, and \
                     here it is {coefficient}: slip would make energy; `dilation = \"hydraulic\"` opens the aperture alone"
                );
                log.add(format!("{key}.dilation"), message);
            }
        }
        log.not_negative(format!("{key}.dilation_limit"), fracture.dilation_limit);
        log.positive(format!("{key}.normal_stiffness"), fracture.normal_stiffness);
        log.positive(format!("{key}.largest_closure"), fracture.largest_closure);
        if fracture.largest_closure.is_some() && fracture.normal_stiffness.is_none() {
            let message = "it needs a normal_stiffness, that at zero stress: without one the closed fracture is rigid";
            log.add(format!("{key}.largest_closure"), message);
        }
        log.not_negative(format!("{key}.residual_aperture"), fracture.residual_aperture);
        log.not_negative(format!("{key}.normal_permeability"), fracture.normal_permeability);
        if self.flow.is_some() && fracture.normal_permeability.is_none() {
            log.add(format!("{key}.normal_permeability"), "this key is required: there is a [flow]");
        }
        let aperture = self.function(&fracture.contact_aperture, Scope::Fracture).ok().and_then(|f| f.as_constant());
        log.positive(format!("{key}.contact_aperture"), aperture.map(Number));
    }

    /// Names of the units: `flow` and `mechanics` where there are, in this order, and those that follow them.
    pub fn unit_names(&self) -> Vec<&str> {
        let coupled = [("flow", self.flow.is_some()), ("mechanics", self.mechanics.is_some())];
        let own =
            coupled.iter().filter(|(name, is_own)| *is_own || self.units.contains_key(*name)).map(|(name, _)| *name);
        let further = self.units.keys().map(String::as_str).filter(|name| coupled.iter().all(|(own, _)| own != name));
        own.chain(further).collect()
    }

    fn check_connections(&self, log: &mut Log) {
        let names = self.unit_names();
        for name in self.units.keys().filter(|name| name.is_empty() || name.contains(['.', '/', '\\'])) {
            log.add(format!("units.{}", quote(name)), "the name of a unit has no dot and no slash");
        }
        if !names.is_empty() && !names.contains(&"flow") && !names.contains(&"mechanics") {
            log.add("units", "one of the units must be `flow` or `mechanics`");
        }
        for (i, connection) in self.connections.iter().enumerate() {
            for (end, text) in [("from", &connection.from), ("to", &connection.to)] {
                let unit = text.split_once('.').map(|(unit, _)| unit);
                if !unit.is_some_and(|unit| names.contains(&unit)) {
                    let message = format!("\"{text}\" is not UNIT.VARIABLE with a unit of {}", names.join(", "));
                    log.add(format!("connections.{i}.{end}"), message);
                }
            }
            if self.connections[..i].iter().any(|earlier| earlier.to == connection.to) {
                log.add(format!("connections.{i}.to"), format!("\"{}\" is connected twice", connection.to));
            }
        }
    }

    fn check_mechanics(&self, log: &mut Log) {
        let Some(mechanics) = &self.mechanics else { return };
        for (i, entry) in mechanics.displacement.iter().enumerate() {
            let key = format!("mechanics.displacement.{i}");
            if entry.on.is_empty() == entry.at.is_none() {
                log.add(key.clone(), "either `on`, boundary tags, or `at`, a point, is required");
            }
            if entry.components().next().is_none() {
                log.add(key.clone(), "at least one of x, y and z is required");
            }
        }
        for (i, entry) in mechanics.traction.iter().enumerate() {
            let key = format!("mechanics.traction.{i}");
            if entry.on.is_empty() {
                log.add(format!("{key}.on"), "at least one boundary tag is required");
            }
        }
        let newton = &mechanics.newton;
        log.positive("mechanics.newton.beta_factor".into(), newton.beta_factor);
        log.number("mechanics.newton.tolerance".into(), newton.tolerance, |v| v > 0.0 && v < 1.0, "between 0 and 1");
        if newton.max_iterations == Some(0) {
            log.add("mechanics.newton.max_iterations", "it must be at least 1");
        }
    }

    fn check_flow(&self, log: &mut Log) {
        let Some(flow) = &self.flow else { return };
        log.positive("flow.fluid.viscosity".into(), flow.fluid.viscosity);
        log.not_negative("flow.fluid.density".into(), flow.fluid.density);
        log.positive("flow.fluid.bulk_modulus".into(), flow.fluid.bulk_modulus);
        for (tag, boundary) in &flow.boundary {
            let key = format!("flow.boundary.{}", quote(tag));
            match (&boundary.pressure, &boundary.inflow, &boundary.fracture_inflow) {
                (Some(_), Some(_), _) => log.add(key, "`pressure` and `inflow` contradict each other"),
                (None, None, None) => log.add(key, "one of `pressure`, `inflow` and `fracture_inflow` is required"),
                _ => {}
            }
        }
        for (name, well) in &flow.wells {
            check_well(&format!("flow.wells.{}", quote(name)), well, log);
        }
    }

    /// What has more or fewer components than the mesh has dimensions.
    fn check_dimension(&self, dim: usize, log: &mut Log) {
        for (name, region) in &self.regions {
            let problem = region.permeability.as_ref().and_then(|k| k.problem(dim));
            problem.into_iter().for_each(|p| log.add(format!("regions.{}.permeability", quote(name)), p));
        }
        let mut count = |key: String, found: Option<usize>| {
            if let Some(found) = found.filter(|&found| found != dim) {
                log.add(key, format!("{dim} numbers are required, not {found}: the mesh has {dim} dimensions"));
            }
        };
        let mut outside = Vec::new();
        if let Some(mechanics) = &self.mechanics {
            for (i, entry) in mechanics.displacement.iter().enumerate() {
                let key = format!("mechanics.displacement.{i}");
                count(format!("{key}.at"), entry.at.as_ref().map(|at| at.0.len()));
                outside.extend(entry.components().filter(|c| c.0 >= dim).map(|c| format!("{key}.{}", c.1)));
            }
            for (i, entry) in mechanics.traction.iter().enumerate() {
                let beyond = entry.components().filter(|c| c.0 >= dim);
                outside.extend(beyond.map(|c| format!("mechanics.traction.{i}.{}", c.1)));
            }
            count("mechanics.body_force".into(), mechanics.body_force.as_ref().map(Vec::len));
        }
        if let Some(flow) = &self.flow {
            count("flow.gravity".into(), flow.gravity.as_ref().map(|gravity| gravity.0.len()));
            for (name, well) in &flow.wells {
                let key = |kind: &str| format!("flow.wells.{}.{kind}", quote(name));
                for (kind, point) in [("cell", &well.cell), ("fracture_face", &well.fracture_face)] {
                    count(key(kind), point.as_ref().map(|point| point.0.len()));
                }
                match &well.direction {
                    Some(_) if dim == 2 => outside.push(key("direction")),
                    direction => count(key("direction"), direction.as_ref().map(|point| point.0.len())),
                }
            }
        }
        outside.into_iter().for_each(|key| log.add(key, "the mesh has two dimensions"));
    }

    /// What does not fit the mesh: names on one side that the other does not have, and, where only the mesh tells its dimension,
    /// what has not as many components.
    pub(crate) fn mesh_problems(&self, mesh: &Mesh) -> Vec<(String, String)> {
        let mut log = Log::default();
        if self.dim().is_none() {
            self.check_dimension(mesh.dim(), &mut log);
        }
        let data = mesh.data();
        let known = |names: &[String]| {
            if names.is_empty() { "the mesh has none".into() } else { format!("the mesh has {}", names.join(", ")) }
        };
        let mut both = |kind: &str, given: Vec<&String>, found: &[String]| {
            for name in given.iter().filter(|&&name| !found.contains(name)) {
                let message = format!("the mesh has nothing of this name; {}", known(found));
                log.add(format!("{kind}.{}", quote(name)), message);
            }
            for name in found.iter().filter(|name| !given.contains(name)) {
                log.add(format!("{kind}.{}", quote(name)), "the mesh has it, but it is not described here");
            }
        };
        // A region that no cell has any more needs no rock.
        let mut used = vec![false; data.regions.len()];
        data.cell_region.iter().for_each(|&r| used[r] = true);
        let regions: Vec<String> = data.regions.iter().zip(used).filter(|r| r.1).map(|r| r.0.clone()).collect();
        both("regions", self.regions.keys().collect(), &regions);
        let network = mesh.network();
        let mut used = vec![false; data.fractures.len()];
        network.fracture.iter().for_each(|&f| used[f] = true);
        let fractures: Vec<String> = data.fractures.iter().zip(used).filter(|f| f.1).map(|f| f.0.clone()).collect();
        both("fractures", self.fractures.keys().collect(), &fractures);

        let tags: Vec<String> =
            data.tags.iter().filter(|tag| mesh.tagged_faces(tag).next().is_some()).cloned().collect();
        let mut tag = |key: String, name: &String| {
            if !tags.contains(name) {
                log.add(key, format!("no boundary face has the tag \"{name}\"; {}", known(&tags)));
            }
        };
        if let Some(mechanics) = &self.mechanics {
            let displacement = mechanics.displacement.iter().map(|d| &d.on).enumerate();
            let traction = mechanics.traction.iter().map(|d| &d.on).enumerate();
            for (kind, (i, on)) in displacement.map(|d| ("displacement", d)).chain(traction.map(|d| ("traction", d))) {
                for (j, name) in on.iter().enumerate() {
                    tag(format!("mechanics.{kind}.{i}.on.{j}"), name);
                }
            }
        }
        for name in self.flow.iter().flat_map(|f| f.boundary.keys()) {
            tag(format!("flow.boundary.{}", quote(name)), name);
        }
        self.check_apertures(mesh, &mut log);
        log.0
    }

    /// Contact apertures that are not positive, or too small for what is said of closure: one message each a fracture.
    fn check_apertures(&self, mesh: &Mesh, log: &mut Log) {
        let network = mesh.network();
        let tips = TipDistances::new(mesh);
        for (i, name) in mesh.data().fractures.iter().enumerate() {
            let Some(fracture) = self.fractures.get(name) else { continue };
            let Ok(aperture) = self.function(&fracture.contact_aperture, Scope::Fracture) else { continue };
            let own = network.faces.iter().zip(&network.fracture).filter(|of| *of.1 == i).map(|of| *of.0);
            let values: Vec<(Vec3, f64)> = own
                .map(|face| mesh.geometry().face_center[face])
                .map(|center| (center, aperture.at(&tips.point(i, center))))
                .collect();
            let mut check = |ok: &dyn Fn(f64) -> bool, key: &str, allowed: &str| {
                let wrong: Vec<_> = values.iter().filter(|(_, value)| !ok(*value)).collect();
                if let Some((Vec3 { x, y, z }, value)) = wrong.first() {
                    let message = format!(
                        "it is {value:.3e} at ({x:.4e}, {y:.4e}, {z:.4e}) m, the middle of one of {} such faces; it must be {allowed}",
                        wrong.len()
                    );
                    log.add(format!("fractures.{}.{key}", quote(name)), message);
                }
            };
            check(&|value| value > 0.0 && value.is_finite(), "contact_aperture", "positive and finite (m)");
            if let Some(Number(largest)) = fracture.largest_closure {
                let allowed = format!("above largest_closure, {largest:.3e} m: else the fracture closes to nothing");
                check(&|value| value > largest, "contact_aperture", &allowed);
            }
            if let Some(Number(residual)) = fracture.residual_aperture {
                let allowed = format!("at least residual_aperture, {residual:.3e} m");
                check(&|value| value >= residual, "contact_aperture", &allowed);
            }
        }
    }
}

fn check_mesh_source(mesh: &MeshSource, log: &mut Log) {
    let given = [mesh.cartesian.is_some(), mesh.triangles.is_some(), mesh.corner_point.is_some(), mesh.file.is_some()];
    let count = given.iter().filter(|&&g| g).count();
    if count != 1 {
        log.add(
            "mesh",
            format!("exactly one of `box`, `triangles`, `corner_point` and `file` is required, not {count}"),
        );
    }
    if let Some(grid) = &mesh.corner_point {
        for name in grid.regions.iter().flat_map(|r| r.names.keys()).filter(|name| name.parse::<i64>().is_err()) {
            log.add(format!("mesh.corner_point.regions.names.{}", quote(name)), "the key must be a whole number");
        }
    }
    if let Some(b) = &mesh.cartesian {
        let dim = b.low.0.len();
        if b.high.0.len() != dim || b.cells.len() != dim {
            log.add("mesh.box", "`low`, `high` and `cells` must have as many numbers");
        }
        if b.low.0.iter().zip(&b.high.0).any(|(low, high)| low >= high) {
            log.add("mesh.box.high", "every component must be above that of `low`");
        }
        if b.cells.contains(&0) {
            log.add("mesh.box.cells", "every number must be at least 1");
        }
        let count = b.cells.iter().fold(1_usize, |product, &n| product.saturating_mul(n));
        if count > MOST_CELLS {
            log.add("mesh.box.cells", format!("together more cells than the {MOST_CELLS} that are allowed"));
        }
        log.number("mesh.box.kershaw".into(), b.kershaw, |v| v > 0.0 && v <= 1.0, "above 0 and at most 1");
    }
    if let Some(t) = &mesh.triangles {
        log.positive("mesh.triangles.size".into(), t.size);
        log.positive("mesh.triangles.fracture_size".into(), t.fracture_size);
        log.number("mesh.triangles.growth".into(), t.growth, |v| v > 0.0 && v <= 1.0, "above 0 and at most 1");
        if (0..2).any(|i| t.low.0[i] >= t.high.0[i]) {
            log.add("mesh.triangles.high", "every component must be above that of `low`");
        }
        for (kind, lines) in [("fractures", &t.fractures), ("interfaces", &t.interfaces)] {
            for (name, line) in lines {
                let key = format!("mesh.triangles.{kind}.{}", quote(name));
                log.positive(format!("{key}.size"), line.size);
                if line.points.len() < 2 {
                    log.add(format!("{key}.points"), "a line has at least two points");
                }
                if kind == "fractures" && line.size.is_none() && t.fracture_size.is_none() {
                    log.add(key, "`size`, or `fracture_size` of mesh.triangles, is required");
                }
            }
        }
    }
    if let Some(extrude) = &mesh.extrude {
        let is_solid = mesh.corner_point.as_ref().is_some_and(|grid| !grid.section);
        if is_solid || mesh.cartesian.as_ref().is_some_and(|b| b.low.0.len() == 3) {
            log.add("mesh.extrude", "only a 2D mesh can be extruded");
        }
        let levels = &extrude.levels;
        if levels.len() < 2 || levels.windows(2).any(|pair| pair[0] >= pair[1]) {
            log.add("mesh.extrude.levels", "at least two heights, ascending, are required");
        }
        if extrude.layers.len() + 1 != levels.len() || extrude.layers.contains(&0) {
            log.add("mesh.extrude.layers", "one number, at least 1, is required between each level and the next");
        }
        for (name, range) in &extrude.fractures {
            let is_level = |z: f64| levels.contains(&Number(z));
            if !(range.0[0] < range.0[1] && range.0.into_iter().all(is_level)) {
                let key = format!("mesh.extrude.fractures.{}", quote(name));
                log.add(key, "two heights, ascending, are required, both in mesh.extrude.levels");
            }
        }
    }
    if let Some(perturb) = &mesh.perturb {
        log.number("mesh.perturb.amplitude".into(), perturb.amplitude, |v| (0.0..0.5).contains(&v), "in 0..0.5");
    }
    if let Some(planarity) = mesh.planarity {
        log.number("mesh.planarity".into(), planarity, |v| v >= 0.0, "at least 0");
    }
    if mesh.cells == crate::Cells::Agglomerate(0) {
        log.add("mesh.cells.agglomerate", "it must be at least 1");
    }
}

fn check_well(key: &str, well: &Well, log: &mut Log) {
    let mut one = |a: bool, b: bool, names: &str| {
        if a == b {
            log.add(key, format!("exactly one of {names} is required"));
        }
    };
    one(well.cell.is_some(), well.fracture_face.is_some(), "`cell` and `fracture_face`");
    one(well.rate.is_some(), well.pressure.is_some(), "`rate` and `pressure`");
    if well.rate.is_none() || well.limit.is_some() || well.index.is_some() && well.radius.is_some() {
        one(well.index.is_some(), well.radius.is_some(), "`index` and `radius`");
    }
    if let Some(direction) = &well.direction {
        if well.cell.is_none() || well.radius.is_none() {
            log.add(format!("{key}.direction"), "it is of use with `cell` and `radius` only");
        }
        if direction.vector() == mesh::Vec3::ZERO {
            log.add(format!("{key}.direction"), "its length is 0");
        }
    }
    if well.pressure.is_some() && well.limit.is_some() {
        log.add(format!("{key}.limit"), "only a well with a rate can have a limit");
    }
    log.positive(format!("{key}.index"), well.index);
    log.positive(format!("{key}.radius"), well.radius);
}

fn check_time(time: &Time, log: &mut Log) {
    if time.end <= time.start {
        log.add("time.end", "it must be after time.start");
    }
    log.positive("time.step".into(), time.step);
    check_step_count(time, log);
    log.positive("time.minimum".into(), time.minimum);
    if let (Some(minimum), Some(step)) = (time.minimum, time.step)
        && minimum > step
    {
        log.add("time.minimum", "it must not exceed time.step");
    }
    if let Some(adaptive) = &time.adaptive {
        log.number("time.adaptive.from".into(), adaptive.from, f64::is_finite, "finite");
        if adaptive.from.is_some() && time.step.is_none() {
            log.add("time.adaptive.from", "time.step is required with it");
        }
        log.positive("time.adaptive.maximum".into(), adaptive.maximum);
        log.positive("time.adaptive.target_iterations".into(), adaptive.target_iterations);
        log.number("time.adaptive.growth".into(), adaptive.growth, |v| v > 1.0, "above 1");
        for (name, &change) in &adaptive.largest_change {
            check_field(&format!("time.adaptive.largest_change.{}", quote(name)), name, log);
            log.positive(format!("time.adaptive.largest_change.{}", quote(name)), change);
        }
    }
}

/// Whether the run would come to its end: where steps are fixed, and by the largest one where they adapt.
fn check_step_count(time: &Time, log: &mut Log) {
    let (start, end) = (time.start.0, time.end.0);
    let fixed_to = match &time.adaptive {
        None => end,
        Some(adaptive) => adaptive.from.map_or(start, |from| from.0.clamp(start.min(end), end)),
    };
    let largest = time.adaptive.as_ref().and_then(|adaptive| adaptive.maximum);
    let parts = [("time.step", time.step, start, fixed_to), ("time.adaptive.maximum", largest, fixed_to, end)];
    for (key, step, from, to) in parts {
        let Some(Number(step)) = step else { continue };
        let least = ((to - from) / MOST_TIME_STEPS).max(LEAST_OF_TIME * from.abs().max(to.abs()));
        if step > 0.0 && to > from && step < least {
            let message = format!(
                "{step:e} s is too small from {from} to {to} s; it must be at least {least:.3e} s, so that there are at most \
                 {MOST_TIME_STEPS:.0} time steps and none is lost in round-off"
            );
            log.add(key, message);
        }
    }
}

fn check_field(key: &str, name: &str, log: &mut Log) {
    if !FIELDS.contains(&name) {
        log.add(key, format!("there is no coupling field of this name; known: {}", FIELDS.join(", ")));
    }
}

fn check_coupling(coupling: &Coupling, log: &mut Log) {
    if coupling.max_iterations == 0 {
        log.add("coupling.max_iterations", "it must be at least 1");
    }
    let relaxation = |v: f64| v > 0.0 && v < 2.0;
    const RANGE: &str = "above 0 and below 2";
    let key = |name: &str| format!("coupling.acceleration.{name}");
    match coupling.acceleration {
        Acceleration::None => {}
        Acceleration::Relaxation { factor } => log.number(key("relaxation.factor"), factor, relaxation, RANGE),
        Acceleration::Aitken { initial } => log.number(key("aitken.initial"), initial, relaxation, RANGE),
        Acceleration::Anderson { depth, mixing } => {
            log.number(key("anderson.mixing"), mixing, |v| v > 0.0 && v <= 1.0, "above 0 and at most 1");
            if depth == 0 {
                log.add(key("anderson.depth"), "it must be at least 1");
            }
        }
        Acceleration::IqnIls { initial, .. } => log.number(key("iqn_ils.initial"), initial, relaxation, RANGE),
        Acceleration::NewtonKrylov { krylov: 0 } => {
            log.add(key("newton_krylov.krylov"), "it must be at least 1");
        }
        Acceleration::NewtonKrylov { .. } => {}
    }
    if coupling.loose && ![Acceleration::None, Acceleration::default()].contains(&coupling.acceleration) {
        log.add("coupling.acceleration", "loose coupling has one pass per time step: there is nothing to accelerate");
    }
    for (name, &Criterion { tolerance, floor, .. }) in &coupling.criteria {
        let key = format!("coupling.criteria.{}", quote(name));
        check_field(&key, name, log);
        log.positive(format!("{key}.tolerance"), tolerance);
        log.not_negative(format!("{key}.floor"), floor);
    }
    let s = &coupling.sensitivity;
    let key = |name: &str| format!("coupling.sensitivity.{name}");
    log.not_negative(key("matrix_compliance_factor"), s.matrix_compliance_factor);
    log.not_negative(key("fracture_compliance_floor_factor"), s.fracture_compliance_floor_factor);
    log.positive(key("matrix_stiffness_cap"), s.matrix_stiffness_cap);
    log.positive(key("fracture_stiffness_cap"), s.fracture_stiffness_cap);
}
