//! How points of a model give way when they are pushed, which bounds what a substep resolves at a contact.

use super::analysis::{mass_matrix_at_rest, point_jacobian_at_rest, pose_at_rest};
use super::cable::CableEnd;
use super::model::{IDENTITY, Model};
use super::topology::{Feature, Form, Pair};
use crate::dynamics::spatial::{dot, mat_vec, neg, transpose};
use nalgebra::{DMatrix, RowVector3};

/// Acceleration per force, 1/kg, that points of each feature give way with at rest: largest eigenvalue of J M⁻¹ Jᵀ with J the
/// Jacobian of the point; 0 of what stands still. A push on a ball passes through its centre.
pub(super) struct Mobility {
    /// Most of any of its points.
    pub(super) of_points: Vec<f64>,
    /// That, or where it is more that of all points with which its body falls flat on the ground, pushed alike at once.
    pub(super) on_ground: Vec<f64>,
    /// Of its balls, which may all touch at once: most of any, or a quarter of the sum where that is more, since what one
    /// step size suits rests on four points.
    of_balls: Vec<f64>,
}

/// Of one point of a body, largest over its directions.
fn of_point(model: &Model, inverse: &DMatrix<f64>, body: Option<usize>, point: [f64; 3]) -> f64 {
    let Some(body) = body else { return 0.0 };
    let jacobian = point_jacobian_at_rest(model, body, point);
    let linear = jacobian.rows(0, 3);
    (linear * inverse * linear.transpose()).symmetric_eigenvalues().max()
}

/// Of cables: acceleration per tension with which their ends part, where all cables of a tree pull at
/// once.
pub(super) fn of_cables(model: &Model) -> Vec<f64> {
    let Some(inverse) = mass_matrix_at_rest(model).try_inverse() else { return vec![0.0; model.cables().len()] };
    let roots = super::model::root_of(model.bodies());
    let of_end = |end: &CableEnd| of_point(model, &inverse, end.body, end.point);
    let all: Vec<_> =
        model.cables().iter().flat_map(|c| &c.ends).map(|e| (e.body.map(|b| roots[b]), of_end(e))).collect();
    let of_tree = |tree: Option<usize>| all.iter().filter(|(own, _)| *own == tree).map(|(_, m)| m).sum::<f64>();
    let of_cable = |ends: &[CableEnd; 2]| ends.iter().map(|e| of_tree(e.body.map(|b| roots[b]))).sum();
    model.cables().iter().map(|cable| of_cable(&cable.ends)).collect()
}

impl Mobility {
    /// With points that stand out as far as others, less `sink`, for those that touch with them.
    pub(super) fn of(model: &Model, features: &[Feature], sink: f64) -> Self {
        let Some(inverse) = mass_matrix_at_rest(model).try_inverse() else {
            let none = vec![0.0; features.len()];
            return Self { of_points: none.clone(), on_ground: none.clone(), of_balls: none };
        };
        let at = |feature: &Feature, point: [f64; 3]| of_point(model, &inverse, feature.body, point);
        let of_points = |f: &Feature| f.form.points().iter().map(|p| at(f, *p)).fold(0.0, f64::max);
        let of_balls = |f: &Feature| {
            let own: Vec<f64> = f.balls.iter().map(|ball| at(f, ball.center)).collect();
            own.iter().copied().fold(0.25 * own.iter().sum::<f64>(), f64::max)
        };
        let flat: Vec<f64> =
            (0..model.bodies().len()).map(|body| flat(model, features, body, &inverse, sink)).collect();
        let of_points: Vec<f64> = features.iter().map(of_points).collect();
        let on_ground = features.iter().zip(&of_points);
        let on_ground = on_ground.map(|(f, own)| f.body.map_or(*own, |body| own.max(flat[body])));
        Self { on_ground: on_ground.collect(), of_points, of_balls: features.iter().map(of_balls).collect() }
    }

    pub(super) fn of_pair(&self, features: &[Feature], Pair { first, second, by_balls }: Pair) -> f64 {
        if !by_balls {
            return self.of_points[first] + self.of_points[second];
        }
        let at_once = (0.25 * features[first].balls.len() as f64).max(1.0);
        self.of_balls[first] + at_once * self.of_points[second]
    }
}

/// Most, over the sides of a body and of its boxes, of the mobility of all its n points that meet level ground there at once, pushed
/// alike: 1ᵀ N M⁻¹ Nᵀ 1/n, the rows of N their speeds across that ground.
fn flat(model: &Model, features: &[Feature], body: usize, inverse: &DMatrix<f64>, sink: f64) -> f64 {
    let own = || features.iter().filter(|f| f.body == Some(body));
    let points: Vec<_> = own().flat_map(|f| f.form.points().iter().map(|p| (*p, f.radius))).collect();
    let rotation = pose_at_rest(model, body).rotation;
    let boxes = own().filter_map(|f| if let Form::Box(block) = &f.form { Some(block.rotation) } else { None });
    let sides = boxes.chain([IDENTITY]).flat_map(transpose);
    let mut most = 0.0_f64;
    for down in sides.flat_map(|axis| [axis, neg(axis)]) {
        let reach = |(point, radius): &([f64; 3], f64)| dot(*point, down) + radius;
        let lowest = points.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
        let touching: Vec<_> = points.iter().filter(|p| reach(p) > lowest - sink).collect();
        let normal = mat_vec(rotation, down);
        let mut rows = DMatrix::zeros(touching.len(), inverse.nrows());
        for (mut row, (point, _)) in rows.row_iter_mut().zip(touching) {
            let jacobian = point_jacobian_at_rest(model, body, *point);
            row.copy_from(&(RowVector3::from(normal) * jacobian.rows(0, 3)));
        }
        if rows.nrows() > 0 {
            most = most.max((&rows * inverse * rows.transpose()).sum() / rows.nrows() as f64);
        }
    }
    most
}
