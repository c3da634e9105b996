//! Scenes as TOML: the fields of [`Scene`] by their own names, SI units, and `[[generate]]` tables that are drawn from seeds.

use super::{Gate, Generator, Obstacle, Scene};
use crate::contact::ContactMaterial;
use crate::mesh::{MeshTable, meshes};
use crate::uneven_ground::UnevenGround;
use crate::vehicle_file::in_file;
use base::error::Result;
use base::reader;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Largest scene file, bytes.
const MAX_FILE_BYTES: u64 = 16 << 20;

/// What a file may say.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct SceneFile {
    generate: Vec<Generator>,
    ground: Option<f64>,
    relief: Option<UnevenGround>,
    gates: Vec<Gate>,
    obstacles: Vec<Obstacle>,
    mesh: Vec<MeshTable>,
    materials: BTreeMap<String, ContactMaterial>,
}

impl Scene {
    /// Reads and checks a scene; `file_name` is for messages. What is drawn comes first, in the order of its tables; where
    /// there are several of them, names begin with kind and number of the table: `forest 1/trunk 3`. Ground and relief are
    /// those of the file, or else the first that is drawn.
    ///
    /// ```
    /// # use omnidrones_dynamics::omnidrones;
    /// use omnidrones::dynamics::scene::Scene;
    /// let scene = Scene::from_toml_str(r#"
    ///     [[generate]]
    ///     kind = "forest"
    ///     seed = 3
    ///     trunks = 60
    ///
    ///     [[obstacles]]
    ///     name = "crate"
    ///     shape = { geometry = { box = { size = [1.0, 1.0, 1.0] } }, position = [0.0, 4.0, 0.5] }
    /// "#, "mine.toml")?;
    /// assert!(scene.ground == Some(0.0) && scene.obstacles.len() == 61);
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Format`](base::error::Error::Format) with line or element for what is no TOML, an unknown key, and numbers that
    /// [`validate`](Self::validate) or a generator refuses; as [`Mesh`](crate::Mesh) for meshes, whose files are
    /// named from the working folder.
    pub fn from_toml_str(text: &str, file_name: &str) -> Result<Self> {
        Self::from_text(text, file_name, Path::new(""))
    }

    /// Names of files in it count from `folder`.
    fn from_text(text: &str, file_name: &str, folder: &Path) -> Result<Self> {
        let file: SceneFile = reader::of_toml(text, file_name)?;
        file.scene(folder).map_err(|error| in_file(error, file_name))
    }

    /// Reads and checks a scene file of at most 16 MiB. Files of meshes are named from its folder.
    ///
    /// # Errors
    /// As [`from_toml_str`](Self::from_toml_str); [`Error::File`](base::error::Error::File) and
    /// [`Error::Limit`](base::error::Error::Limit) for what cannot be read.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = base::file_gate::read_text(path, MAX_FILE_BYTES)?;
        Self::from_text(&text, &path.display().to_string(), path.parent().unwrap_or(Path::new("")))
    }
}

impl SceneFile {
    fn scene(self, folder: &Path) -> Result<Scene> {
        let mut all = Scene::default();
        let several = self.generate.len() > 1;
        for (i, generator) in self.generate.iter().enumerate() {
            let mut drawn = generator.scene()?;
            let names =
                drawn.gates.iter_mut().map(|g| &mut g.name).chain(drawn.obstacles.iter_mut().map(|o| &mut o.name));
            names.filter(|_| several).for_each(|name| *name = format!("{} {i}/{name}", generator.kind()));
            all.ground = all.ground.or(drawn.ground);
            all.relief = all.relief.or(drawn.relief);
            all.gates.append(&mut drawn.gates);
            all.obstacles.append(&mut drawn.obstacles);
        }
        all.ground = self.ground.or(all.ground);
        all.relief = self.relief.or(all.relief);
        all.materials = self.materials;
        all.gates.extend(self.gates);
        all.obstacles.extend(self.obstacles);
        all.mesh = meshes(self.mesh, folder)?;
        all.validate()?;
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(text: &str) -> String {
        Scene::from_toml_str(text, "mine.toml").unwrap_err().to_string()
    }

    #[test]
    fn a_scene_comes_back_from_its_own_toml() {
        for text in ["forest:2", "gates", "rooms:5"] {
            let scene = Generator::parse(text).unwrap().scene().unwrap();
            let file = toml::to_string(&scene).unwrap();
            assert_eq!(Scene::from_toml_str(&file, "mine.toml").unwrap(), scene);
        }
    }

    #[test]
    fn tables_are_drawn_and_joined_under_names_of_their_own() {
        let text = "ground = -0.5\n[[generate]]\nkind = 'forest'\nclear = [14.0, 1.0]\ntrunks = 3\n\
                    [[generate]]\nkind = 'gates'\ngates = 2\n[[gates]]\nposition = [9.0, 3.0, 1.0]";
        let scene = Scene::from_toml_str(text, "mine.toml").unwrap();
        let names: Vec<_> =
            scene.gates.iter().map(|g| &g.name).chain(scene.obstacles.iter().map(|o| &o.name)).collect();
        let want =
            ["gates 1/gate 0", "gates 1/gate 1", "gate", "forest 0/trunk 0", "forest 0/trunk 1", "forest 0/trunk 2"];
        assert_eq!(names, want);
        assert_eq!(scene.ground, Some(-0.5));
    }

    #[test]
    fn mistakes_name_file_value_limit_and_remedy() {
        let text = told("[[generate]]\nkind = 'forest'\ntrunks = 200");
        assert!(text.starts_with("mine.toml: forest: trunks: is 200, over the limit of 135 with radius"), "{text}");
        let text = told("[[generate]]\nkind = 'forest'\ntrunk = 20");
        assert!(text.contains("unknown field `trunk`") && text.contains("Did you mean `trunks`?"), "{text}");
        let text = told("[[generate]]\nkind = 'woods'");
        assert!(text.contains("unknown variant `woods`"), "{text}");
        let text = told("[[obstacles]]\nname = 'a'\nshape = { geometry = { sphere = { radius = -1.0 } } }");
        assert!(text.starts_with("mine.toml: obstacle 'a': radius: is -1, but it must be between"), "{text}");
    }
}
