//! How far away things are from what flies.

use crate::suite::obstacles::{CollisionShapes, Outline};
use crate::task::View;
use autodiff::Scalar;
use dynamics::spatial::Vec3;

impl<S: Scalar> View<'_, S> {
    /// Least distance of the shapes of a tree that touch to capsules of `radius` around segments, m, negative where they overlap. `None` for a
    /// vehicle alone, which touches nothing, and for no such tree.
    pub fn clearance(&self, tree: usize, segments: &[[Vec3<S>; 2]], radius: f64) -> Option<S> {
        let model = self.robot.model().filter(|model| tree < model.layout().trees.len())?;
        Some(CollisionShapes::of_tree(model, tree).clearance(self, segments, radius))
    }

    /// Least distance of a drone, propellers included, to upright columns at `places` (x, y) that are higher than it flies, m, up to `most`.
    /// `None` where drones are no plain vehicles, and for no such drone.
    pub fn clearance_to_columns(&self, drone: usize, places: &[[S; 2]], radii: &[f64], most: f64) -> Option<S> {
        let vehicle = self.robot.vehicle.as_ref().filter(|_| drone < self.robot.drones().len())?;
        Some(Outline::of(vehicle).clearance(&self.drone(drone), |i| places[i], &radii[..places.len()], most))
    }
}
