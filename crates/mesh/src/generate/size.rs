//! How large triangles are to be.

use glam::DVec2;

/// Points per leaf of the tree: a few are compared faster than a split is passed.
const LEAF: usize = 8;

struct Branch {
    low: DVec2,
    high: DVec2,
    /// Least size of the points below.
    least: f64,
    first: usize,
    last: usize,
    /// The second of its two parts; the first follows it. 0 in a leaf.
    second: usize,
}

/// The size h(x) = min_i (s_i + g |x − x_i|) of points x_i with sizes s_i: the largest field of growth rate g
/// that does not exceed s_i at x_i. A tree of boxes finds the least term.
pub(crate) struct SizeField {
    points: Vec<(DVec2, f64)>,
    branches: Vec<Branch>,
    growth: f64,
    far: f64,
}

impl SizeField {
    pub(crate) fn new(mut points: Vec<(DVec2, f64)>, growth: f64, far: f64) -> Self {
        let mut branches = Vec::new();
        let n = points.len();
        if n > 0 {
            split(&mut points, 0, n, &mut branches);
        }
        Self { points, branches, growth, far }
    }

    /// The size at `x`, and the number of the point that sets it. `hint` is such a number from nearby.
    pub(crate) fn at(&self, x: DVec2, hint: usize) -> (f64, usize) {
        let mut best = (self.far, hint);
        let term = |i: usize| self.points[i].1 + self.growth * self.points[i].0.distance(x);
        if hint < self.points.len() {
            best = (best.0.min(term(hint)), hint);
        }
        let mut stack = Vec::with_capacity(32);
        if !self.branches.is_empty() {
            stack.push(0);
        }
        while let Some(b) = stack.pop() {
            let branch = &self.branches[b];
            let distance = (branch.low - x).max(x - branch.high).max(DVec2::ZERO).length();
            if branch.least + self.growth * distance >= best.0 {
                continue;
            }
            if branch.second == 0 {
                for i in branch.first..branch.last {
                    let value = term(i);
                    if value < best.0 {
                        best = (value, i);
                    }
                }
            } else {
                stack.extend([branch.second, b + 1]);
            }
        }
        best
    }
}

fn split(points: &mut [(DVec2, f64)], first: usize, last: usize, branches: &mut Vec<Branch>) {
    let own = &mut points[first..last];
    let low = own.iter().fold(DVec2::INFINITY, |m, p| m.min(p.0));
    let high = own.iter().fold(DVec2::NEG_INFINITY, |m, p| m.max(p.0));
    let least = own.iter().fold(f64::INFINITY, |m, p| m.min(p.1));
    let b = branches.len();
    branches.push(Branch { low, high, least, first, last, second: 0 });
    if last - first > LEAF {
        let axis = usize::from(high.y - low.y > high.x - low.x);
        let middle = (last - first) / 2;
        own.select_nth_unstable_by(middle, |p, q| p.0[axis].total_cmp(&q.0[axis]));
        split(points, first, first + middle, branches);
        branches[b].second = branches.len();
        split(points, first + middle, last, branches);
    }
}
