//! Parts of a composed scene and their names in the model.

use crate::catalog::Category;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InstanceKind {
    /// Movable object.
    Object,
    /// Fixture, whose base does not move, although its drawers and doors do.
    Fixture,
}

/// An object or fixture and its names in the model.
#[derive(Debug, Clone)]
pub struct Instance {
    /// Instance name, for example `akita_black_bowl_1`.
    pub name: String,
    pub kind: InstanceKind,
    pub category: &'static Category,
    /// Name of the outermost body.
    pub root_body: String,
    /// Names of the joints, in document order; an object's free joint is the last.
    pub joints: Vec<String>,
    /// Names of the collision geoms.
    pub contact_geoms: Vec<String>,
    /// Site of a stove's burner, which is visible while the stove is on.
    pub burner_site: Option<String>,
}

#[derive(Debug, Clone)]
pub struct RegionSite {
    pub name: String,
    /// Half extents in the site's frame, m.
    pub half_size: [f64; 3],
    /// Instance that the site is attached to; `None` for a zone on the workspace.
    pub parent: Option<String>,
    /// Joints of the body that the site is attached to, such as a drawer's slide.
    pub joints: Vec<String>,
}
