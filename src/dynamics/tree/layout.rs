//! Where every number of an articulated system stands in its state and input.

use super::parts::{Body, ModelParts, Motion, root_of};
use crate::rigid::{Disturbance, RIGID_DIM};

/// Place of one body's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BodyPlace {
    /// First coordinate of its joint in the state: one number of a hinge or slide, four of a ball; of a floating body
    /// the position, with velocity, attitude and angular velocity behind it as in
    /// [`RigidState`](crate::RigidState).
    pub position: usize,
    /// First velocity of its joint in the state: one, three of a ball; of a floating body as said above.
    pub velocity: usize,
    /// First of its degrees of freedom in a velocity vector ν (see [`Layout::n_velocity`]).
    pub freedom: usize,
    /// Number of degrees of freedom: 6, 1 or 3.
    pub n_freedom: usize,
}

/// One root with all that hangs on it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreePlace {
    /// Numbers of its bodies.
    pub bodies: std::ops::Range<usize>,
    /// Numbers of its rotors.
    pub rotors: std::ops::Range<usize>,
    /// Its part of the state.
    pub state: std::ops::Range<usize>,
    /// Its part of the input.
    pub input: std::ops::Range<usize>,
    /// Its nine numbers of a [`Disturbance`] in the input, if there is that effect.
    pub disturbance: Option<usize>,
}

/// Places of all numbers.
///
/// State, tree by tree: a floating root's 13 numbers as in [`RigidState`](crate::RigidState), joint positions
/// in the order of the bodies, joint velocities, rotor speeds. Input, tree by tree: rotor actions, drive commands in the
/// order of the bodies, then with the effect `disturbance` wind, force and moment on the root.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Per body.
    pub bodies: Vec<BodyPlace>,
    /// Place of each rotor's speed in the state.
    pub rotor_speed: Vec<usize>,
    /// Place of each rotor's action in the input.
    pub rotor_action: Vec<usize>,
    /// Place of each body's drive command in the input, if it has a drive.
    pub drive: Vec<Option<usize>>,
    /// Per root.
    pub trees: Vec<TreePlace>,
    n_velocity: usize,
}

impl Layout {
    /// Without disturbances.
    pub(crate) fn of(parts: &ModelParts) -> Self {
        Self::with_disturbance(parts, false)
    }

    pub(crate) fn with_disturbance(parts: &ModelParts, disturbance: bool) -> Self {
        let roots = root_of(&parts.bodies);
        let blank = BodyPlace { position: 0, velocity: 0, freedom: 0, n_freedom: 0 };
        let mut layout = Self {
            bodies: vec![blank; parts.bodies.len()],
            rotor_speed: vec![0; parts.rotors.len()],
            rotor_action: vec![0; parts.rotors.len()],
            drive: vec![None; parts.bodies.len()],
            trees: Vec::new(),
            n_velocity: 0,
        };
        let mut begin = 0;
        let mut first_rotor = 0;
        while begin < parts.bodies.len() {
            let end = (begin..parts.bodies.len()).find(|i| roots[*i] != begin).unwrap_or(parts.bodies.len());
            let count = parts.rotors[first_rotor..].iter().take_while(|r| roots[r.body] == begin).count();
            layout.place_tree(&parts.bodies, begin..end, first_rotor..first_rotor + count, disturbance);
            (begin, first_rotor) = (end, first_rotor + count);
        }
        layout
    }

    fn place_tree(
        &mut self,
        bodies: &[Body],
        range: std::ops::Range<usize>,
        rotors: std::ops::Range<usize>,
        disturbance: bool,
    ) {
        let (start, first_input) = (self.n_state(), self.n_input());
        let mut at = start;
        for i in range.clone() {
            let place = &mut self.bodies[i];
            (place.freedom, place.n_freedom) = (self.n_velocity, freedoms(&bodies[i]));
            self.n_velocity += place.n_freedom;
            place.position = at;
            match bodies[i].joint.motion {
                Motion::Floating => {
                    place.velocity = at + 3;
                    at += RIGID_DIM;
                }
                Motion::Revolute(_) | Motion::Prismatic(_) => at += 1,
                Motion::Ball => at += 4,
            }
        }
        for i in range.clone() {
            if bodies[i].joint.motion != Motion::Floating {
                self.bodies[i].velocity = at;
                at += self.bodies[i].n_freedom;
            }
        }
        for r in rotors.clone() {
            self.rotor_speed[r] = at;
            at += 1;
        }
        let mut input = first_input;
        for r in rotors.clone() {
            self.rotor_action[r] = input;
            input += 1;
        }
        for i in range.clone() {
            if bodies[i].joint.drive.is_some() {
                self.drive[i] = Some(input);
                input += 1;
            }
        }
        let air = disturbance.then_some(input);
        input += if disturbance { Disturbance::<f64>::DIM } else { 0 };
        let (state, input) = (start..at, first_input..input);
        self.trees.push(TreePlace { bodies: range, rotors, state, input, disturbance: air });
    }

    /// Length of the state.
    pub fn n_state(&self) -> usize {
        self.trees.last().map_or(0, |t| t.state.end)
    }

    /// Length of the input.
    pub fn n_input(&self) -> usize {
        self.trees.last().map_or(0, |t| t.input.end)
    }

    /// Degrees of freedom: numbers of a velocity vector ν, body by body. A floating body has its origin's velocity
    /// (world) and its angular velocity (body); a ball its angular velocity relative to the parent (child's axes).
    pub fn n_velocity(&self) -> usize {
        self.n_velocity
    }
}

fn freedoms(body: &Body) -> usize {
    match body.joint.motion {
        Motion::Floating => 6,
        Motion::Revolute(_) | Motion::Prismatic(_) => 1,
        Motion::Ball => 3,
    }
}
