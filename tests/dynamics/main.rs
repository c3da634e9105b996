//! Bodies: what the physics promises, one subject per file; files and parts that become models; batches.

mod assembly;
mod batch;
#[path = "../common/mod.rs"]
mod common;
mod configurations;
mod contact_material;
mod fleet;
mod hover;
mod multibody;
mod physics;
mod poison;
mod relief;
mod scenes;
mod slopes;
mod tree;
mod tree_batch;
mod unit_length;
mod urdf_articulated;
mod urdf_diagnosis;
mod urdf_fuzz;
mod urdf_import;
mod urdf_units;
