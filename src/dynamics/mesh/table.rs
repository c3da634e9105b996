//! Meshes as TOML tables, and the files that they name.

use super::check::{Triangles, check_count};
use super::{MAX_TRIANGLES, Mesh, Source, backend};
use crate::scene::{MAX_ELEMENTS, unique};
use crate::shape::upright;
use base::error::{Error, Result};
use base::file_gate;
use base::memory::Request;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Largest STL file, bytes: a million triangles are 50 MB in binary, and some five times as much as text.
const MAX_STL_BYTES: u64 = 256 << 20;
/// Fewest bytes of a triangle in a text, and most of memory that one takes while its tree is made.
const TEXT_TRIANGLE: usize = 90;
const TRIANGLE_BYTES: u128 = 400;
/// Most triangles of all meshes of a scene, each counted where it stands: as many as rays can tell apart.
const MAX_ALL: usize = crate::sensors::cast::MAX_TRIANGLES;
/// Largest file of heights, bytes.
const MAX_CSV_BYTES: u64 = 64 << 20;

/// A `[[mesh]]` of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MeshTable {
    #[serde(default = "unnamed")]
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    vertices: Option<Vec<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    triangles: Option<Vec<[u32; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    heights: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spacing: Option<[f64; 2]>,
    #[serde(default)]
    position: [f64; 3],
    #[serde(default = "upright")]
    rotation: [f64; 4],
    #[serde(default = "one")]
    scale: f64,
    #[serde(default = "yes")]
    contact: bool,
}

fn unnamed() -> String {
    "mesh".into()
}

fn one() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

/// The meshes of a scene; names of files count from `folder`. A file that several of them name, be it by names of its own, is read
/// once, and their surface is one.
///
/// # Errors
/// As [`MeshTable::mesh`]; more than [`MAX_ELEMENTS`] of them, or more than [`MAX_ALL`] triangles of all.
pub(crate) fn meshes(tables: Vec<MeshTable>, folder: &Path) -> Result<Vec<Mesh>> {
    if tables.len() > MAX_ELEMENTS {
        let remedy = "Make one mesh of several.";
        return Err(Error::limit("scene: number of meshes", tables.len(), MAX_ELEMENTS, remedy));
    }
    unique("mesh", tables.iter().map(|table| table.name.as_str()))?;
    let (mut all, mut known, mut sum) = (Vec::with_capacity(tables.len()), HashMap::new(), 0);
    for table in tables {
        // the end of a name says how it is read
        let read_as = |path: &Path| (path.extension().map(OsString::from), table.spacing.map(|d| d.map(f64::to_bits)));
        let path = table.file.as_ref().map(|file| folder.join(file));
        let file = path.as_ref().map(|path| (file_gate::identity(path), read_as(path)));
        let alone = table.vertices.is_none() && table.triangles.is_none() && table.heights.is_none();
        let mesh = match file.as_ref().filter(|_| alone).and_then(|file| known.get(file)) {
            Some(mesh) => table.placed(Mesh { source: named(mesh, path.unwrap_or_default()), ..Mesh::clone(mesh) })?,
            None => table.mesh(folder)?,
        };
        sum += mesh.n_triangle();
        if sum > MAX_ALL {
            let remedy = "Simplify meshes, or leave some out.";
            return Err(Error::limit("scene: triangles of all meshes", sum, MAX_ALL, remedy));
        }
        if let Some(file) = file {
            known.entry(file).or_insert_with(|| mesh.clone());
        }
        all.push(mesh);
    }
    Ok(all)
}

impl MeshTable {
    /// The mesh; names of files count from `folder`.
    pub(crate) fn mesh(mut self, folder: &Path) -> Result<Mesh> {
        backend::ready()?;
        let (name, path) = (self.name.clone(), self.file.as_ref().map(|file| folder.join(file)));
        let (vertices, triangles, heights) = (self.vertices.take(), self.triangles.take(), self.heights.take());
        let mesh = match (path, vertices, triangles, heights, self.spacing) {
            (Some(path), None, None, None, spacing) => from_path(name, &path, spacing)?,
            (None, Some(vertices), Some(triangles), None, None) => Mesh::new(name, vertices, triangles)?,
            (None, None, None, Some(heights), Some(spacing)) => Mesh::height_field(name, heights, spacing)?,
            _ => {
                let (what, rule) =
                    (format!("mesh '{name}'"), "one of file, vertices with triangles, and heights with spacing");
                return Err(Error::value(what, "none or several of them", rule, "Leave the other keys out."));
            }
        };
        self.placed(mesh)
    }

    /// A mesh of the same surface under the name and in the place of this table.
    fn placed(self, mesh: Mesh) -> Result<Mesh> {
        let Self { name, position, rotation, scale, contact, .. } = self;
        let mesh = Mesh { name, position, rotation, scale, contact, ..mesh };
        mesh.validate(&format!("mesh '{}'", mesh.name))?;
        Ok(mesh)
    }
}

/// Where a mesh comes from, under another name of that file.
fn named(mesh: &Mesh, path: PathBuf) -> Source {
    match &mesh.source {
        Source::HeightFile(_, spacing) => Source::HeightFile(path, *spacing),
        _ => Source::File(path),
    }
}

/// By the end of its name.
fn from_path(name: String, path: &Path, spacing: Option<[f64; 2]>) -> Result<Mesh> {
    let end = path.extension().and_then(|end| end.to_str()).map(str::to_ascii_lowercase);
    match (end.as_deref(), spacing) {
        (Some("stl"), None) => Mesh::from_file(name, path),
        (Some("csv"), Some(spacing)) => Mesh::height_field_from_file(name, path, spacing),
        _ => {
            let limit = "a name that ends in .stl, or one in .csv with a spacing";
            let remedy = "Save triangles as STL; heights as CSV, with spacing = [dx, dy] in metres.";
            Err(Error::value(format!("mesh '{name}': file"), path.display(), limit, remedy))
        }
    }
}

impl TryFrom<MeshTable> for Mesh {
    type Error = Error;

    fn try_from(table: MeshTable) -> Result<Self> {
        table.mesh(Path::new(""))
    }
}

impl From<Mesh> for MeshTable {
    fn from(mesh: Mesh) -> Self {
        let Mesh { name, position, rotation, scale, contact, source, surface } = mesh;
        let (file, vertices, triangles, heights, spacing) = (None, None, None, None, None);
        let blank = Self { name, file, vertices, triangles, heights, spacing, position, rotation, scale, contact };
        match source {
            Source::Triangles => {
                let own = surface.triangles.clone();
                Self { vertices: Some(own.vertices), triangles: Some(own.triangles), ..blank }
            }
            Source::File(path) => Self { file: Some(path), ..blank },
            Source::HeightFile(path, spacing) => Self { file: Some(path), spacing: Some(spacing), ..blank },
            Source::Heights(heights, spacing) => {
                Self { heights: Some(heights.to_vec()), spacing: Some(spacing), ..blank }
            }
        }
    }
}

/// The triangles of an STL file; corners at the same place are one vertex.
pub(super) fn read_stl(what: &str, path: &Path) -> Result<Triangles> {
    let bytes = file_gate::read(path, MAX_STL_BYTES)?;
    check_memory(what, bytes.get(80..84).map_or(0, |n| most(&bytes, n)))?;
    let (mut vertices, mut triangles, mut known) = (Vec::new(), Vec::new(), HashMap::new());
    let refused = backend::corners_of_stl(bytes, &mut |corners| {
        let number = corners.map(|corner| {
            // −0 is the same place
            let place = corner.map(|x| x + 0.0);
            *known.entry(place.map(f32::to_bits)).or_insert_with(|| {
                vertices.push(place.map(f64::from));
                vertices.len() as u32 - 1
            })
        });
        triangles.push(number);
        if triangles.len() > MAX_TRIANGLES { check_count(what, triangles.len()) } else { Ok(()) }
    })?;
    match refused {
        None => Ok(Triangles { vertices, triangles }),
        Some(why) => Err(Error::Format {
            file: path.display().to_string(),
            place: format!("triangle {}", triangles.len()),
            rule: format!("is no STL ({why})"),
            remedy: "Save the mesh as STL again, binary or text.".into(),
        }),
    }
}

/// Most triangles that a file can hold; `count` is where a binary one says how many.
fn most(bytes: &[u8], count: &[u8]) -> usize {
    let told = count.try_into().map_or(0, u32::from_le_bytes) as usize;
    if bytes.len() as u64 == 84 + 50 * told as u64 { told } else { bytes.len() / TEXT_TRIANGLE }
}

/// Asks for the memory of so many triangles before it is taken.
fn check_memory(what: &str, n: usize) -> Result<()> {
    let request = Request {
        what: &format!("{what}: number of triangles"),
        value: n,
        bytes: n.min(MAX_TRIANGLES) as u128 * TRIANGLE_BYTES,
        limit: u64::MAX,
        setting: "the memory",
        less: "Simplify the mesh",
    };
    request.check(|bytes| (u128::from(bytes) / TRIANGLE_BYTES).to_string())
}

/// The rows of a file of heights.
pub(super) fn read_heights(path: &Path) -> Result<Vec<Vec<f64>>> {
    let text = file_gate::read_text(path, MAX_CSV_BYTES)?;
    let mut rows =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(text.as_bytes());
    let refused = |i: usize, rule: String| Error::Format {
        file: path.display().to_string(),
        place: format!("line {}", i + 1),
        rule,
        remedy: "Give numbers alone: a row of heights (m) per line.".into(),
    };
    let number = |i: usize, cell: &str| cell.parse::<f64>().map_err(|_| refused(i, format!("'{cell}' is no number")));
    rows.records()
        .enumerate()
        .map(|(i, row)| row.map_err(|e| refused(i, e.to_string()))?.iter().map(|cell| number(i, cell)).collect())
        .collect()
}
