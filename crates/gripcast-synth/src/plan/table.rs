//! Drafts from a user's table of objects.

use std::path::Path;

use serde::Deserialize;

use super::{Drafts, MeshSource, ObjectDraft, TextureDraft};
use crate::properties::{DescribedAppearance, FRICTION_RANGE, Material};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, SimulationId, read_text};
use gripcast_base::random::SeedStream;
use gripcast_geometry::{MeshOptions, check_mass, load_object_mesh_below};

/// Version of the format.
const SCHEMA: u32 = 1;
/// Default width of textures on objects, m.
const TEXTURE_WIDTH_M: f64 = 0.1;

/// `objects.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    schema: u32,
    #[serde(default)]
    object: Vec<toml::Table>,
}

/// One object of the table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: SimulationId,
    mesh: String,
    unit: Option<String>,
    scale: Option<f64>,
    category: String,
    material: String,
    fill: Option<f64>,
    mass_kg: Option<f64>,
    friction: Option<f64>,
    #[serde(default)]
    appearances: Vec<String>,
    #[serde(default)]
    textures: Vec<String>,
    texture_width_m: Option<f64>,
}

/// Reads a table of objects; objects that cannot be used are left out.
///
/// ```toml
/// schema = 1
///
/// [[object]]
/// name = "blue-mug"              # letters, digits, - _ .
/// mesh = "mug.obj"               # below the table's folder, or builtin:NAME
/// unit = "mm"                    # of the mesh's coordinates; not needed for builtin:NAME
/// category = "mug"
/// material = "ceramic"           # default density, friction and appearances
/// # optional:
/// scale = 1.0
/// fill = 1.0                     # fraction of the mesh's volume that is material
/// mass_kg = 0.21
/// friction = 0.6                 # against the gel, 0.1 to 1.5
/// appearances = ["glossy blue enamel", "chipped white enamel"]
/// textures = ["label.png"]       # PNG or JPEG, below the table's folder
/// texture_width_m = 0.08         # of the image on the object
/// ```
///
/// # Errors
/// Errors of reading the table; `Input` for an invalid table or one without objects.
pub fn table_drafts(table: &Path, seed: u64) -> Result<Drafts> {
    let at = |e: Error| e.at(table.display());
    let text = read_text(table, FileKind::Record)
        .map_err(|e| at(Error::io("cannot read the table of objects", e)))?;
    let found: Table = toml::from_str(&text).map_err(|e| at(invalid_table().because(e)))?;
    if found.schema != SCHEMA {
        let what = format!(
            "expected a table of schema {SCHEMA}, found schema {}",
            found.schema
        );
        let remedy = "use the version of gripcast that it was written for";
        return Err(at(Error::input(what).remedy(remedy)));
    }
    if found.object.is_empty() {
        return Err(at(invalid_table()));
    }
    let folder = Root::new(table.parent().unwrap_or(Path::new(".")));
    let mut drafts = Drafts::default();
    for (number, row) in found.object.into_iter().enumerate() {
        let name = row.get("name").and_then(toml::Value::as_str);
        let name = name.map_or_else(|| format!("object {}", number + 1), str::to_owned);
        let read = row
            .try_into()
            .map_err(|e: toml::de::Error| invalid_table().because(e))
            .and_then(|row: Row| draft(row, &folder, seed));
        drafts.push(&name, read)?;
    }
    Ok(drafts)
}

fn invalid_table() -> Error {
    Error::input("not a table of objects").remedy(
        "write schema = 1 and for each object [[object]] with name, mesh, unit, category and \
         material (docs/how-to/synth.md)",
    )
}

fn draft(row: Row, folder: &Root, seed: u64) -> Result<ObjectDraft> {
    in_range("fill", row.fill, [0.0, 1.0])?;
    in_range("friction", row.friction, FRICTION_RANGE)?;
    if row.category.trim().is_empty() {
        return Err(Error::input("`category` is empty"));
    }
    let material = Material::named(&row.material)?;
    let is_builtin = row.mesh.starts_with("builtin:");
    let unit = match (&row.unit, is_builtin) {
        (Some(unit), _) => unit.as_str(),
        (None, true) => "m",
        (None, false) => {
            return Err(
                Error::input("`unit` is missing: mesh files do not define their unit")
                    .remedy("write unit = \"mm\", \"cm\", \"m\" or \"in\""),
            );
        }
    };
    let options = MeshOptions::new(unit.parse()?, row.scale.unwrap_or(1.0));
    let mesh = load_object_mesh_below(folder, &row.mesh, &options)?.mesh;
    if let Some(mass_kg) = row.mass_kg {
        check_mass(mass_kg, &mesh.bounds())?;
    }
    let seed = SeedStream::named(seed, &format!("object {}", row.name)).bits();
    let width_m = row.texture_width_m.unwrap_or(TEXTURE_WIDTH_M);
    let texture = |file: &String| {
        let path = folder.resolve_allowed(file).map_err(|_| {
            let what = format!("the texture {file:?} is not below the folder of the table");
            Error::input(what).remedy(
                "copy the image beside the table, or allow its folder with \
                 GRIPCAST__FILES__LINKED_FOLDERS",
            )
        })?;
        TextureDraft::from_file(path, width_m)
    };
    Ok(ObjectDraft {
        category: row.category.trim().to_owned(),
        source: MeshSource::stored(&row.name)?,
        mesh,
        material,
        fill: row.fill,
        mass_kg: row.mass_kg,
        friction: row.friction,
        appearances: row
            .appearances
            .iter()
            .map(|words| DescribedAppearance::from_words(words, material, seed))
            .collect(),
        textures: row.textures.iter().map(texture).collect::<Result<_>>()?,
        grasps: None,
        name: row.name,
    })
}

fn in_range(name: &str, value: Option<f64>, [low, high]: [f64; 2]) -> Result<()> {
    match value {
        Some(value) if !(value > 0.0 && value >= low && value <= high) => Err(Error::input(
            format!("`{name}` must be above 0 and from {low} to {high}, found {value}"),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;

    fn read(rows: &str) -> Result<Drafts> {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("objects.toml");
        fs::write(&table, format!("schema = 1\n{rows}")).unwrap();
        let image = image::RgbImage::new(4, 2);
        image.save(folder.path().join("label.png")).unwrap();
        let mesh = "v 0 0 0\nv 40 0 0\nv 0 40 0\nv 0 0 40\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
        fs::write(folder.path().join("corner.obj"), mesh).unwrap();
        let outside = tempfile::tempdir().unwrap();
        fs::write(outside.path().join("corner.obj"), mesh).unwrap();
        let link = folder.path().join("out.obj");
        std::os::unix::fs::symlink(outside.path().join("corner.obj"), link).unwrap();
        table_drafts(&table, 1)
    }

    const MUG: &str = "[[object]]\nname = \"mug\"\nmesh = \"builtin:mug\"\ncategory = \"mug\"\n\
                       material = \"ceramic\"\n";
    const CORNER: &str = "[[object]]\nname = \"corner\"\nmesh = \"corner.obj\"\nunit = \"mm\"\n\
                          category = \"block\"\nmaterial = \"pine\"\n";

    #[test]
    fn objects_match_their_table() {
        let more = "mass_kg = 0.05\nfriction = 0.7\nfill = 0.5\ntextures = [\"label.png\"]\n\
                    appearances = [\"glossy blue paint\"]\nscale = 2.0\n";
        let read = read(&format!("{MUG}{CORNER}{more}")).unwrap();
        assert!(read.left_out.is_empty(), "{:?}", read.left_out);
        let [mug, corner] = read.drafts.as_slice() else {
            panic!("two objects");
        };
        assert_eq!(
            (mug.mass_kg, mug.friction, mug.appearances.len()),
            (None, None, 0)
        );
        assert_eq!((corner.mass_kg, corner.friction), (Some(0.05), Some(0.7)));
        assert_eq!(corner.appearances[0].description, "glossy blue paint");
        assert_eq!(corner.textures[0].planned.name, "label");
        assert!((corner.mesh.bounds().extent().max_element() - 0.08).abs() < 1e-12);
        let MeshSource::File { file } = &corner.source else {
            panic!("a file");
        };
        assert_eq!(*file, "corner.ply");
    }

    #[test]
    fn invalid_rows_are_left_out_with_reasons() {
        let wrong = [
            ("mass_kg = 210", "at most 10 kg"),
            ("mass_kg = 9", "osmium"),
            ("friction = 0.01", "from 0.1 to 1.5"),
            ("fill = nan", "fill"),
            ("scale = -1", "scale"),
            ("textures = [\"other.png\"]", "other.png"),
            ("textures = [\"../label.png\"]", "../label.png"),
            ("textures = [\"/label.png\"]", "/label.png"),
            ("colour = \"red\"", "colour"),
        ];
        for (line, words) in wrong {
            let read = read(&format!("{MUG}{CORNER}{line}\n")).unwrap();
            assert_eq!(read.drafts.len(), 1, "{line}");
            let left_out = &read.left_out[0];
            assert_eq!(left_out.name, "corner");
            assert!(
                left_out.reason.contains(words),
                "{line}: {}",
                left_out.reason
            );
        }
        for (from, to, words) in [
            ("unit = \"mm\"\n", "", "unit"),
            ("pine", "pyne", "pine"),
            ("corner.obj", "other.obj", "other.obj"),
            ("\"mm\"", "\"furlong\"", "furlong"),
            ("\"corner\"", "\"a/b\"", "a/b"),
            ("corner.obj", "../corner.obj", "beside"),
            ("corner.obj", "/etc/hostname", "LINKED_FOLDERS"),
            ("corner.obj", "out.obj", "out.obj"),
        ] {
            let read = read(&format!("{MUG}{}", CORNER.replace(from, to))).unwrap();
            assert!(
                read.left_out[0].reason.contains(words),
                "{:?}",
                read.left_out
            );
        }
    }

    #[test]
    fn invalid_tables_have_a_remedy() {
        for text in ["", "[[objects]]\n", "object = 3"] {
            let error = read(text).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Input, "{text}");
            assert!(
                error
                    .remedy_text()
                    .is_some_and(|r| r.contains("[[object]]"))
            );
        }
        assert!(table_drafts(Path::new("/nothing"), 0).is_err());
    }
}
