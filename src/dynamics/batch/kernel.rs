//! The lane kernel of a batch: one block of environments, one step.
//!
//! A block holds [`BLOCK`] environments as structure of arrays: row k is number k of every environment. State rows come
//! first, then the action's, the disturbance's, the flag `alive`. The model's constants stand in rows of their own, one
//! set for all environments that share them, so that a batch without randomisation reads them from cache.

use super::plant::Block;
use crate::autodiff::lanes::{Kernel, Lanes};
use crate::autodiff::program::BLOCK;
use crate::autodiff::unrolled::unrolled;
use crate::autodiff::{Mask, safe};
use crate::dynamics::integrate::{Grid, step};
use crate::dynamics::rigid::{Disturbance, Effects, RIGID_DIM, RigidModel, RigidState};
use crate::dynamics::rotor::{Motors, RotorModel};

/// Largest magnitude of a healthy state, SI units.
pub(crate) const EXPLODED: f64 = 1e8;

/// Values of the row `alive`: stepping whatever comes of it, stepping, stopped in this step, stopped earlier and listed.
pub(crate) const HEEDLESS: f32 = 2.0;
pub(crate) const ALIVE: f32 = 1.0;
pub(crate) const STOPPED: f32 = 0.0;
pub(crate) const LISTED: f32 = -1.0;

/// Row numbers within a block of `R` (padded) rotors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows {
    pub action: usize,
    pub disturbance: usize,
    pub alive: usize,
    pub count: usize,
}

impl Rows {
    #[inline(always)]
    pub(crate) const fn of(r: usize) -> Self {
        let action = RIGID_DIM + r;
        let disturbance = action + r;
        let alive = disturbance + 9;
        Self { action, disturbance, alive, count: alive + 1 }
    }
}

/// Applies a macro to the numbers of a rotor that lean kernels read, in the order of their rows.
macro_rules! lean_rotor {
    ($each:ident, $r:ident, $m:ident) => {
        $each!($r.force[2], $r.moment[0], $r.moment[1], $r.moment[2], $r.max_speed, $m.up.decay, $m.down.decay)
    };
}

/// As `lean_rotor` for what other kernels read besides.
#[rustfmt::skip]
macro_rules! rest_rotor {
    ($each:ident, $r:ident, $m:ident) => {
        $each!(
            $r.force[0], $r.force[1], $m.up.rate, $m.down.rate, $r.hub[0], $r.hub[1], $r.hub[2],
            $r.axis[0], $r.axis[1], $r.axis[2], $r.spin_inertia, $r.drag, $r.axial_drag, $r.rolling, $r.radius
        )
    };
}

/// Whether any effect needs the constants behind the lean ones.
#[inline(always)]
fn needs_rest(e: Effects) -> bool {
    e.quadratic_drag
        || e.rotor_drag
        || e.rolling_moment
        || e.rotor_inertia
        || e.ground_effect
        || e.tilted_rotors
        || e.products_of_inertia
}

/// A model as numbers in the order that [`unpack`] reads them, one by one into `put`.
pub(crate) fn pack<const R: usize>(m: &RigidModel<f64, R>, mut put: impl FnMut(f64)) {
    let mut all = |numbers: &[f64]| numbers.iter().for_each(|x| put(*x));
    all(&[m.gravity, m.inverse_mass]);
    all(&m.center_of_mass);
    all(&m.inertia[..3]);
    all(&m.inverse_inertia[..3]);
    all(&m.linear_drag);
    all(&m.angular_drag);
    macro_rules! put {
        ($($number:expr),*) => { all(&[$($number),*]) };
    }
    for (rotor, motors) in m.rotors.iter().zip(&m.motors) {
        lean_rotor!(put, rotor, motors);
    }
    all(&[m.mass]);
    all(&m.inertia[3..]);
    all(&m.inverse_inertia[3..]);
    all(&m.quadratic_drag);
    all(&[m.ground_height]);
    for (rotor, motors) in m.rotors.iter().zip(&m.motors) {
        rest_rotor!(put, rotor, motors);
    }
}

/// Reads rows one after the other at one register's place.
struct Cursor<'a> {
    rows: &'a [[f32; BLOCK]],
    at: usize,
    row: usize,
}

impl Cursor<'_> {
    #[inline(always)]
    fn next<L: Lanes>(&mut self) -> L {
        let value = L::load(&self.rows[self.row][self.at..]);
        self.row += 1;
        value
    }

    #[inline(always)]
    fn array<L: Lanes, const N: usize>(&mut self) -> [L; N] {
        let mut values = [L::zero(); N];
        unrolled!(k in 0..N {
            values[k] = self.next();
        });
        values
    }
}

#[inline(always)]
fn unpack<L: Lanes, const R: usize>(c: &mut Cursor<'_>, effects: Effects) -> RigidModel<L, R> {
    let o = L::zero();
    let (gravity, inverse_mass) = (c.next(), c.next());
    let center_of_mass = c.array();
    let [xx, yy, zz] = c.array();
    let [ixx, iyy, izz] = c.array();
    let (linear_drag, angular_drag) = (c.array(), c.array());
    macro_rules! take {
        ($($number:expr),*) => { $($number = c.next();)* };
    }
    let (mut rotors, mut motors) = ([RotorModel::dead(); R], [Motors::none(); R]);
    unrolled!(i in 0..R {
        let (rotor, own) = (&mut rotors[i], &mut motors[i]);
        lean_rotor!(take, rotor, own);
    });
    let mut model = RigidModel {
        gravity,
        mass: o,
        inverse_mass,
        center_of_mass,
        inertia: [xx, yy, zz, o, o, o],
        inverse_inertia: [ixx, iyy, izz, o, o, o],
        linear_drag,
        angular_drag,
        quadratic_drag: [o; 3],
        ground_height: o,
        n_rotor: R,
        rotors,
        motors,
    };
    if needs_rest(effects) {
        unpack_rest(c, &mut model);
    }
    model
}

#[inline(always)]
fn unpack_rest<L: Lanes, const R: usize>(c: &mut Cursor<'_>, model: &mut RigidModel<L, R>) {
    macro_rules! take {
        ($($number:expr),*) => { $($number = c.next();)* };
    }
    model.mass = c.next();
    for k in 3..6 {
        model.inertia[k] = c.next();
    }
    for k in 3..6 {
        model.inverse_inertia[k] = c.next();
    }
    model.quadratic_drag = c.array();
    model.ground_height = c.next();
    unrolled!(i in 0..R {
        let (rotor, motors) = (&mut model.rotors[i], &mut model.motors[i]);
        rest_rotor!(take, rotor, motors);
    });
}

/// Steps every block of a chunk once, for the dispatcher.
pub(crate) struct StepBlocks<'a, const R: usize> {
    pub blocks: &'a mut [Block],
    /// Numbers of all blocks without their own.
    pub shared: &'a [[f32; BLOCK]],
    pub effects: Effects,
    pub grid: Grid,
}

impl<const R: usize> Kernel for StepBlocks<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { blocks, shared, effects, grid } = self;
        for b in 0..blocks.len() {
            let mut at = 0;
            while at < blocks[b].occupied {
                let block = &mut blocks[b];
                // a constant lets the compiler leave out what is switched off
                if effects == Effects::lean() {
                    StepRegister::<R, true> { block, at, shared, effects, grid }.outlined::<L>();
                } else {
                    StepRegister::<R, false> { block, at, shared, effects, grid }.outlined::<L>();
                }
                at += L::WIDTH;
            }
        }
    }
}

/// Steps one register of environments.
struct StepRegister<'a, const R: usize, const LEAN: bool> {
    block: &'a mut Block,
    at: usize,
    shared: &'a [[f32; BLOCK]],
    effects: Effects,
    grid: Grid,
}

impl<const R: usize, const LEAN: bool> Kernel for StepRegister<'_, R, LEAN> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let model = match &self.block.numbers {
            Some(own) => Cursor { rows: own, at: self.at, row: 0 },
            // equal in every lane: the first register's place stays in cache
            None => Cursor { rows: self.shared, at: 0, row: 0 },
        };
        let effects = if LEAN { Effects::lean() } else { self.effects };
        step_lanes::<L, R>(&mut self.block.rows[..Rows::of(R).count], model, self.at, effects, self.grid);
    }
}

/// One register of environments. A lane that was not alive, or whose new state is not finite and bounded, keeps its
/// state and ceases to be alive; its neighbours do not notice.
#[inline(always)]
fn step_lanes<L: Lanes, const R: usize>(
    block: &mut [[f32; BLOCK]],
    mut numbers: Cursor<'_>,
    at: usize,
    effects: Effects,
    grid: Grid,
) {
    let rows = Rows::of(R);
    let mut c = Cursor { rows: block, at, row: 0 };
    let x = RigidState::<L, R> {
        position: c.array(),
        velocity: c.array(),
        attitude: c.array(),
        angular_velocity: c.array(),
        rotor_speed: c.array(),
    };
    let action: [L; R] = c.array();
    let air = if effects.disturbance {
        Disturbance { wind: c.array(), force: c.array(), moment: c.array() }
    } else {
        Disturbance::none()
    };
    c.row = rows.alive;
    let alive: L = c.next();
    let model = unpack::<L, R>(&mut numbers, effects);
    let y = step(&model, effects, grid, &x, &action, &air);

    let was_alive = L::constant(0.5).lt(alive);
    let mut ok = was_alive;
    unrolled!(k in 0..3 {
        ok = ok.and(safe::is_bounded(y.position[k], EXPLODED));
        ok = ok.and(safe::is_bounded(y.velocity[k], EXPLODED));
        ok = ok.and(safe::is_bounded(y.angular_velocity[k], EXPLODED));
    });
    unrolled!(k in 0..4 {
        ok = ok.and(safe::is_bounded(y.attitude[k], EXPLODED));
    });
    unrolled!(k in 0..R {
        ok = ok.and(safe::is_bounded(y.rotor_speed[k], EXPLODED));
    });
    ok = ok.or(heedless(alive));
    unrolled!(k in 0..3 {
        L::select(ok, y.position[k], x.position[k]).store(&mut block[k][at..]);
        L::select(ok, y.velocity[k], x.velocity[k]).store(&mut block[3 + k][at..]);
        L::select(ok, y.angular_velocity[k], x.angular_velocity[k]).store(&mut block[10 + k][at..]);
    });
    unrolled!(k in 0..4 {
        L::select(ok, y.attitude[k], x.attitude[k]).store(&mut block[6 + k][at..]);
    });
    unrolled!(k in 0..R {
        L::select(ok, y.rotor_speed[k], x.rotor_speed[k]).store(&mut block[RIGID_DIM + k][at..]);
    });
    let stopped = L::select(was_alive, L::constant(f64::from(STOPPED)), alive);
    L::select(ok, alive, stopped).store(&mut block[rows.alive][at..]);
}

/// Lanes that are to show where a step leads.
#[inline(always)]
pub(crate) fn heedless<L: Lanes>(alive: L) -> L::Mask {
    L::constant(0.5 * f64::from(ALIVE + HEEDLESS)).lt(alive)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autodiff::lanes::dispatch_each;
    use crate::dynamics::multirotor::Physics;
    use crate::dynamics::{Integrator, Vehicle, vehicles};
    use crate::rng::{Purpose, Stream};

    const STEPS: usize = 20;

    /// A block stepped by one instruction set.
    #[derive(Clone, Copy)]
    struct Widths<'a, const R: usize> {
        block: &'a [[f32; BLOCK]],
        model: &'a [[f32; BLOCK]],
        effects: Effects,
        grid: Grid,
    }

    impl<const R: usize> Kernel for Widths<'_, R> {
        type Output = Vec<[f32; BLOCK]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<[f32; BLOCK]> {
            let mut blocks = [Block { occupied: BLOCK, rows: self.block.iter().copied().collect(), numbers: None }];
            for _ in 0..STEPS {
                let (shared, effects, grid) = (self.model, self.effects, self.grid);
                StepBlocks::<R> { blocks: &mut blocks, shared, effects, grid }.run::<L>();
            }
            let [block] = blocks;
            block.rows.to_vec()
        }
    }

    /// Sixty-four different flights, one of them with a NaN action.
    fn block<const R: usize>(vehicle: &Vehicle) -> Vec<[f32; BLOCK]> {
        let rows = Rows::of(R);
        let mut block = vec![[0.0; BLOCK]; rows.count];
        for lane in 0..BLOCK {
            let mut r = Stream::new(80, lane as u64, 0, Purpose::user(80));
            for k in 0..6 {
                block[k][lane] = r.uniform(-2.0, 4.0) as f32;
            }
            let q: Vec<f64> = (0..4).map(|_| r.normal()).collect();
            let norm = q.iter().map(|q| q * q).sum::<f64>().sqrt();
            for k in 0..4 {
                block[6 + k][lane] = (q[k] / norm) as f32;
            }
            for k in 10..13 {
                block[k][lane] = r.uniform(-4.0, 4.0) as f32;
            }
            for (k, rotor) in vehicle.rotors.iter().enumerate() {
                block[RIGID_DIM + k][lane] = (rotor.max_speed * r.uniform(0.0, 1.0)) as f32;
                block[rows.action + k][lane] = r.uniform(-1.2, 1.2) as f32;
            }
            for k in 0..9 {
                block[rows.disturbance + k][lane] = (0.01 * r.uniform(-1.0, 1.0)) as f32;
            }
        }
        block[rows.action][37] = f32::NAN;
        block[rows.alive] = [ALIVE; BLOCK];
        block
    }

    #[test]
    fn sixteen_and_eight_lanes_give_the_same_bits_and_one_lane_the_same_flight() {
        const R: usize = 4;
        let mut worst = 0.0_f32;
        for vehicle in vehicles::all().iter().filter(|v| v.n_rotor() == R) {
            for integrator in [Integrator::RungeKutta4, Integrator::SemiImplicit] {
                for effects in [Effects::none(), Effects::lean(), Effects::default(), Effects::all()] {
                    let physics = Physics { integrator, effects, ..Physics::default() };
                    let grid = physics.grid();
                    let model = RigidModel::<f64, R>::new(vehicle, grid.substep);
                    let start = block::<R>(vehicle);
                    let mut numbers = Vec::new();
                    pack(&model, |x| numbers.push([x as f32; BLOCK]));
                    let effects = model.effects_of(effects);
                    let op = Widths::<R> { block: &start, model: &numbers, effects, grid };
                    let results = dispatch_each(op);
                    let alive = &results[0].1[Rows::of(R).alive];
                    assert_eq!(alive.iter().filter(|a| **a != ALIVE).count(), 1, "the NaN action stops its lane alone");
                    for (set, result) in &results[1..] {
                        for (row, (a, b)) in results[0].1.iter().zip(result).take(Rows::of(R).action).enumerate() {
                            for lane in 0..BLOCK {
                                let (a, b) = (a[lane], b[lane]);
                                let name = format!("{} {integrator:?} {effects:?} row {row} lane {lane}", vehicle.name);
                                if *set == "fallback" {
                                    let error = (a - b).abs() / a.abs().max(1.0);
                                    worst = worst.max(error);
                                    assert!(error <= 1e-3, "{name}: {a} against {b}");
                                } else {
                                    assert_eq!(a.to_bits(), b.to_bits(), "{name} on {set}: {a} against {b}");
                                }
                            }
                        }
                    }
                }
            }
        }
        println!("fallback after {STEPS} steps: {worst:.1e}"); // measured 2.1e-6: it rounds products twice
    }
}
