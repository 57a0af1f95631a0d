//! Entry points for fuzz targets: parsers of single files, without surrounding folders. Programs do
//! not use them.

use std::path::PathBuf;

use crate::catalog::category;
use crate::compose::InstanceKind;
use crate::element::Element;
use crate::object::build;
use crate::part::Part;
use crate::pickle::read_matrix;
use crate::sources::{AssetRoot, RootKind, locate_files};

/// Creates an instance of an object's model and merges it into an empty scene.
///
/// # Panics
/// If the written scene does not parse to the same scene.
pub fn object_model(text: &str, movable: bool) -> Result<(), String> {
    let root = AssetRoot { kind: RootKind::Pack, dir: PathBuf::from("pack"), verified: None };
    let category = category("wooden_cabinet").expect("in the catalogue");
    let kind = if movable { InstanceKind::Object } else { InstanceKind::Fixture };
    let part = Part::parse(text, &root, category.file)?;
    let object = build(part, "cabinet_1", category, kind)?;
    object.region_site("cabinet_1_top_region");
    let mut scene = Part::parse("<mujoco><worldbody/></mujoco>", &root, "base.xml")?;
    scene.merge_assets(&object.part);
    scene.worldbody_mut().children.push(object.body);
    let written = scene.root.write();
    assert_eq!(Element::parse(&written), Ok(scene.root), "{written}");
    locate_files(&written, [&root, &root]);
    Ok(())
}

/// Parses the pickle inside a `.pruned_init` file; returns the numbers of rows and columns.
pub fn pickled_states(bytes: &[u8]) -> Result<[usize; 2], String> {
    let mut storage = |_: &str| Ok(bytes.to_vec());
    read_matrix(bytes, &mut storage).map(|matrix| [matrix.rows, matrix.columns])
}
