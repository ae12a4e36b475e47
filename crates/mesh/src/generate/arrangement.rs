//! Cuts polylines at the points where they meet.

use glam::DVec2;
use robust::{Coord, orient2d};
use rustc_hash::FxHashMap;

/// Which side of the line from `a` to `b` the point `c` lies on: positive to the left; the sign is exact.
pub(crate) fn side(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    let p = |p: DVec2| Coord { x: p.x, y: p.y };
    orient2d(p(a), p(b), p(c))
}

/// The point of the segment from `a` to `b` next to `p`.
pub(crate) fn nearest(a: DVec2, b: DVec2, p: DVec2) -> DVec2 {
    let t = b - a;
    a + t * ((p - a).dot(t) / t.length_squared()).clamp(0.0, 1.0)
}

/// Whether `p` lies inside the polygon (either sense).
pub(crate) fn contains(polygon: &[DVec2], p: DVec2) -> bool {
    let n = polygon.len();
    let mut inside = false;
    for i in 0..n {
        let (a, b) = (polygon[i], polygon[(i + 1) % n]);
        if (a.y > p.y) != (b.y > p.y) {
            let (low, high) = if a.y < b.y { (a, b) } else { (b, a) };
            inside ^= side(low, high, p) > 0.0;
        }
    }
    inside
}

/// Points, of which those closer than a tolerance are one.
struct Points {
    points: Vec<DVec2>,
    tolerance: f64,
    buckets: FxHashMap<(i64, i64), Vec<usize>>,
}

impl Points {
    fn bucket(&self, p: DVec2) -> (i64, i64) {
        let q = (p / (2.0 * self.tolerance)).floor();
        (q.x as i64, q.y as i64)
    }

    fn number(&mut self, p: DVec2) -> usize {
        let (i, j) = self.bucket(p);
        for di in -1..=1 {
            for dj in -1..=1 {
                let near = self.buckets.get(&(i.saturating_add(di), j.saturating_add(dj)));
                if let Some(&k) = near.into_iter().flatten().find(|&&k| self.points[k].distance(p) <= self.tolerance) {
                    return k;
                }
            }
        }
        self.points.push(p);
        self.buckets.entry((i, j)).or_default().push(self.points.len() - 1);
        self.points.len() - 1
    }
}

/// Segments cut where they meet.
pub(crate) struct Arrangement {
    /// The ends of all pieces.
    pub points: Vec<DVec2>,
    /// The pieces of each segment, as points in order along it.
    pub along: Vec<Vec<usize>>,
}

impl Arrangement {
    /// Cuts `segments` where they cross or touch. Points closer than `tolerance` become one, and an end
    /// closer than that to another segment becomes a point of it. Of points that coincide the first counts.
    pub(crate) fn new(segments: &[[DVec2; 2]], tolerance: f64) -> Self {
        let mut points = Points { points: Vec::new(), tolerance, buckets: FxHashMap::default() };
        let mut along: Vec<Vec<usize>> =
            segments.iter().map(|s| s.iter().map(|&p| points.number(p)).collect()).collect();
        for i in 0..segments.len() {
            for j in i + 1..segments.len() {
                let ([a, b], [c, d]) = (segments[i], segments[j]);
                let slack = DVec2::splat(tolerance);
                if a.min(b).cmpgt(c.max(d) + slack).any() || c.min(d).cmpgt(a.max(b) + slack).any() {
                    continue;
                }
                let mut touch = false;
                for (host, ends) in [(i, [c, d]), (j, [a, b])] {
                    let [from, to] = segments[host];
                    for end in ends {
                        if nearest(from, to, end).distance(end) <= tolerance {
                            touch = true;
                            let k = points.number(end);
                            along[host].push(k);
                        }
                    }
                }
                if touch {
                    continue;
                }
                let (sc, sd) = (side(a, b, c), side(a, b, d));
                let (sa, sb) = (side(c, d, a), side(c, d, b));
                let opposite = |p: f64, q: f64| (p > 0.0 && q < 0.0) || (p < 0.0 && q > 0.0);
                if opposite(sc, sd) && opposite(sa, sb) {
                    let k = points.number(c + (d - c) * (sc / (sc - sd)));
                    along[i].push(k);
                    along[j].push(k);
                }
            }
        }
        let points = points.points;
        for (list, [a, b]) in along.iter_mut().zip(segments) {
            let (first, last) = (list[0], list[1]);
            list.retain({
                let mut ends = 0;
                move |&k| {
                    ends += 1;
                    ends <= 2 || (k != first && k != last)
                }
            });
            list.sort_by(|&p, &q| (points[p] - *a).dot(*b - *a).total_cmp(&(points[q] - *a).dot(*b - *a)));
            list.dedup();
        }
        Self { points, along }
    }
}
