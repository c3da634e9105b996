//! How points of a model give way when they are pushed, which bounds what a substep resolves at a contact and in a joint.

use super::cable::CableEnd;
use super::jacobian::{mass_matrix_at_rest, point_jacobian_at_rest, pose_at_rest};
use super::model::{IDENTITY, Model, root_of};
use super::topology::{Feature, Form, Kind, Link, Pair, ResolvedTouches, Topology, Touch};
use crate::contact::force::RESOLVED;
use crate::contact::material::Resolved;
use crate::integrate::{Grid, Integrator};
use crate::rigid::Effects;
use crate::spatial::{dot, mat_vec, neg, transpose};
use nalgebra::{DMatrix, RowVector3};

/// Share of the stiffness that a substep resolves between a box and the corners of another, for 0.4 of the rate: the nearest face
/// changes from one substep to the next.
const OF_CORNERS: f64 = 1.0 / 16.0;

impl Topology {
    /// For steps on a grid. `general` keeps every path open, for numbers that may differ from the model's.
    pub(crate) fn new(model: &Model, effects: Effects, grid: Grid, general: bool) -> Self {
        let mut links = Self::links(model, effects, general);
        // the semi-implicit step takes all damping and springs implicitly as it is
        if grid.integrator == Integrator::RungeKutta4 {
            mark_stiff(model, grid.substep, &mut links);
        }
        let mut topology = Self::with_links(model, effects, links);
        if effects.contact {
            topology.sticks = least_slip_speed(model) < RESOLVED * grid.substep;
            topology.resolve(model, grid);
        }
        let most = |mobility| Resolved::of_spring(mobility, grid);
        topology.resolved.cables = of_cables(model).into_iter().map(most).collect();
        topology
    }

    /// Finds what a substep resolves of every touch.
    fn resolve(&mut self, model: &Model, grid: Grid) {
        let mobility = Mobility::of(model, &self.features, Resolved::sink(grid));
        // the stages of RK4 take all corners of a box at once with what is stable on one; a step of first order gains energy
        let of_ground = match grid.integrator {
            Integrator::RungeKutta4 => &mobility.of_points,
            Integrator::SemiImplicit => &mobility.on_ground,
        };
        let on_ground = |touch: &Touch<usize>| Resolved::of(of_ground[touch.what], grid);
        let of_pair = |touch: &Touch<Pair>| {
            let Pair { first, by_balls, .. } = touch.what;
            let most = Resolved::of(mobility.of_pair(&self.features, touch.what), grid);
            let has_corners = by_balls && matches!(self.features[first].form, Form::Box(_));
            if has_corners { Resolved { stiffness: OF_CORNERS * most.stiffness, ..most } } else { most }
        };
        self.resolved = ResolvedTouches {
            on_ground: self.on_ground.iter().map(on_ground).collect(),
            pairs: self.pairs.iter().map(of_pair).collect(),
            cables: Vec::new(),
        };
    }
}

/// Most that a joint's damping or spring may do in one explicit substep: h d/I and h √(k/I).
const STIFF: f64 = 0.5;

/// Marks the joints whose damping or spring is too fast for explicit steps of `substep` s, by the inertia 1/(M⁻¹)ᵢᵢ that
/// each feels at rest.
fn mark_stiff(model: &Model, substep: f64, links: &mut [Link]) {
    if !links.iter().any(|l| l.damped || l.sprung) {
        return;
    }
    let Some(inverse) = mass_matrix_at_rest(model).try_inverse() else { return };
    for (link, body) in links.iter_mut().zip(model.bodies()) {
        let mobility = inverse[(link.freedom, link.freedom)];
        let rate = substep * body.joint.damping * mobility;
        let frequency = substep * (body.joint.stiffness * mobility).sqrt();
        let one_axis = matches!(link.kind, Kind::Hinge(_) | Kind::Slide(_));
        link.stiff = one_axis && (rate > STIFF || frequency > STIFF);
    }
}

/// Least slip speed of the model's materials, m/s.
fn least_slip_speed(model: &Model) -> f64 {
    let contact = &model.parts().contact;
    let own = model.shapes().iter().filter_map(|s| s.material).chain(contact.ground_material);
    own.fold(contact.material.slip_speed, |least, m| least.min(m.slip_speed))
}

/// Acceleration per force, 1/kg, that points of each feature give way with at rest: largest eigenvalue of J M⁻¹ Jᵀ with J the
/// Jacobian of the point; 0 of what stands still. A push on a ball passes through its centre.
struct Mobility {
    /// Most of any of its points.
    of_points: Vec<f64>,
    /// That, or where it is more that of all points with which its body falls flat on the ground, pushed alike at once.
    on_ground: Vec<f64>,
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
fn of_cables(model: &Model) -> Vec<f64> {
    let Some(inverse) = mass_matrix_at_rest(model).try_inverse() else { return vec![0.0; model.cables().len()] };
    let roots = root_of(model.bodies());
    let of_end = |end: &CableEnd| of_point(model, &inverse, end.body, end.point);
    let all: Vec<_> =
        model.cables().iter().flat_map(|c| &c.ends).map(|e| (e.body.map(|b| roots[b]), of_end(e))).collect();
    let of_tree = |tree: Option<usize>| all.iter().filter(|(own, _)| *own == tree).map(|(_, m)| m).sum::<f64>();
    let of_cable = |ends: &[CableEnd; 2]| ends.iter().map(|e| of_tree(e.body.map(|b| roots[b]))).sum();
    model.cables().iter().map(|cable| of_cable(&cable.ends)).collect()
}

impl Mobility {
    /// With points that stand out as far as others, less `sink`, for those that touch with them.
    fn of(model: &Model, features: &[Feature], sink: f64) -> Self {
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

    fn of_pair(&self, features: &[Feature], Pair { first, second, by_balls }: Pair) -> f64 {
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
