//! The bodies of a plant, and what stands around them, as rays hit them.

use crate::frame::Frame;
use crate::plant::Plant;
use crate::scene::{Obstacle, Scene};
use crate::shape::{Geometry, Pose, Shape};
use crate::tree::Multibody;
use crate::tree::parameters::static_parameters;

/// A shape that a body carries, where it is now.
#[derive(Debug, Clone, Copy)]
pub struct PosedShape {
    /// Number of the body.
    pub body: usize,
    /// Its shape.
    pub geometry: Geometry,
    /// World.
    pub pose: Pose<f64>,
}

/// All shapes that the bodies of a plant carry.
#[derive(Debug, Clone, Default)]
pub struct Solids {
    /// In the frames of their bodies.
    shapes: Vec<(usize, Shape)>,
    now: Vec<PosedShape>,
}

impl Solids {
    #[doc(hidden)]
    pub fn of(plant: &Plant) -> Self {
        let shapes: Vec<(usize, Shape)> = match plant {
            Plant::Rigid(own) => own.vehicle().shapes.iter().map(|shape| (0, *shape)).collect(),
            Plant::Tree(own) => own.model().shapes().iter().filter_map(|s| s.body.map(|b| (b, s.shape))).collect(),
        };
        let now = Vec::with_capacity(shapes.len());
        Self { shapes, now }
    }

    /// Without those of `body`, where nothing else is: what a sensor on the only body sees of bodies.
    #[doc(hidden)]
    pub fn without_lone_body(self) -> Self {
        let first = self.shapes.first().map(|(body, _)| *body);
        if self.shapes.iter().all(|(body, _)| Some(*body) == first) { Self::default() } else { self }
    }

    /// Where bodies with these frames have them.
    #[doc(hidden)]
    pub fn at(&mut self, frame: impl Fn(usize) -> Frame<f64>) -> &[PosedShape] {
        self.now.clear();
        self.now.extend(self.shapes.iter().map(|(body, shape)| {
            let Frame { position, attitude, .. } = frame(*body);
            PosedShape { body: *body, geometry: shape.geometry, pose: shape.pose(&Pose { position, attitude }) }
        }));
        &self.now
    }
}

/// A scene with the shapes of a plant's model that stand still behind its own obstacles, what that model's ground rises by, and its
/// meshes.
#[derive(Debug, Clone)]
pub struct Surroundings {
    /// All of it.
    pub scene: Scene,
    /// Numbers of the placement of the scene itself.
    own: usize,
    /// Of every shape of the model: where its position stands among the plant's numbers, and the nominal one.
    standing: Vec<(usize, [f64; 3])>,
}

impl Surroundings {
    #[doc(hidden)]
    pub fn of(scene: &Scene, plant: &Plant) -> Self {
        let (mut whole, own) = (scene.clone(), scene.n_placement());
        let mut standing = Vec::new();
        if let Some(model) = plant.tree().map(Multibody::model) {
            if whole.ground.is_some() && whole.ground == model.parts().contact.ground && whole.relief.is_none() {
                whole.relief.clone_from(&model.parts().contact.relief);
            }
            let own = scene.mesh.iter();
            let others = model.parts().mesh.iter().filter(|mesh| !own.clone().any(|known| known.is_that(mesh)));
            whole.mesh.extend(others.cloned());
            let still = model.shapes().iter().filter(|shape| shape.body.is_none());
            for (i, shape) in still.enumerate() {
                standing.push((static_parameters(model.bodies().len(), model.rotors().len(), i), shape.shape.position));
                whole.obstacles.push(Obstacle { name: format!("{}/{i}", shape.part), shape: shape.shape });
            }
        }
        Self { scene: whole, own, standing }
    }

    /// Where it all stands with these numbers of the plant; `place` writes the scene's own part.
    #[doc(hidden)]
    pub fn place(&self, numbers: &[f64], placement: &mut Vec<f64>, place: impl FnOnce(&mut [f64])) {
        placement.clear();
        placement.resize(self.own, 0.0);
        place(placement);
        for (at, nominal) in &self.standing {
            placement.extend((0..3).map(|k| numbers[at + k] - nominal[k]));
        }
    }
}
