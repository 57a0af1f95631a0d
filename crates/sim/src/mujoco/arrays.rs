//! Numeric arrays of a compiled model by name, for comparing models. The table omits the contents
//! of meshes, textures and height fields, their search trees, and most arrays of skins and flexible
//! bodies, which no LIBERO scene has. Names and sizes follow MuJoCo 3.3.7's `mjxmacro.h`.

use mujoco_rs::mujoco_c::mjModel;

/// A named array, converted to doubles.
pub struct NamedArray {
    pub name: &'static str,
    /// Values in memory order.
    pub values: Vec<f64>,
}

pub struct ModelArray {
    /// Length along the first axis: bodies, geoms, …
    pub rows: usize,
    /// Values in memory order.
    pub values: Values,
}

pub enum Values {
    Double(Vec<f64>),
    Single(Vec<f32>),
    /// Ids, addresses, numbers, flags.
    Integer(Vec<i32>),
}

impl Values {
    fn widen(self) -> Vec<f64> {
        match self {
            Self::Double(values) => values,
            Self::Single(values) => values.into_iter().map(f64::from).collect(),
            Self::Integer(values) => values.into_iter().map(f64::from).collect(),
        }
    }
}

trait Element: Copy {
    fn collect(values: &[Self]) -> Values;
}

impl Element for f64 {
    fn collect(values: &[Self]) -> Values {
        Values::Double(values.to_vec())
    }
}

impl Element for f32 {
    fn collect(values: &[Self]) -> Values {
        Values::Single(values.to_vec())
    }
}

macro_rules! integers {
    ($($kind:ty),*) => {$(
        impl Element for $kind {
            fn collect(values: &[Self]) -> Values {
                Values::Integer(values.iter().copied().map(i32::from).collect())
            }
        }
    )*};
}
integers!(i32, u8, i8);

fn read<T: Element>(pointer: *const T, count: usize) -> Values {
    if count == 0 {
        return T::collect(&[]);
    }
    // SAFETY: callers pass a field of a live model with the size that MuJoCo's
    // own table gives it.
    T::collect(unsafe { std::slice::from_raw_parts(pointer, count) })
}

macro_rules! arrays {
    ($($name:ident: $rows:ident x $columns:tt $(* $factor:literal)?,)*) => {
        const NAMES: &[&str] = &[$(stringify!($name),)*];

        /// Returns the array with this name; `None` if the table below does not list the name.
        pub(super) fn array(model: &mjModel, name: &str) -> Option<ModelArray> {
            match name {
                $(
                    stringify!($name) => {
                        let rows = model.$rows as usize;
                        let columns = columns!(model, $columns) $(* $factor)?;
                        let values = read(model.$name.cast_const(), rows * columns);
                        Some(ModelArray { rows, values })
                    }
                )*
                _ => None,
            }
        }
    };
}

pub(super) fn all_arrays(model: &mjModel) -> Vec<NamedArray> {
    let named = |name: &&'static str| NamedArray {
        name,
        values: array(model, name).expect("an array of the table").values.widen(),
    };
    NAMES.iter().map(named).collect()
}

macro_rules! columns {
    ($model:ident, $count:literal) => {
        $count
    };
    ($model:ident, $field:ident) => {
        $model.$field as usize
    };
}

arrays! {
    body_parentid: nbody x 1,
    body_rootid: nbody x 1,
    body_weldid: nbody x 1,
    body_mocapid: nbody x 1,
    body_jntnum: nbody x 1,
    body_jntadr: nbody x 1,
    body_dofnum: nbody x 1,
    body_dofadr: nbody x 1,
    body_treeid: nbody x 1,
    body_geomnum: nbody x 1,
    body_geomadr: nbody x 1,
    body_simple: nbody x 1,
    body_sameframe: nbody x 1,
    body_pos: nbody x 3,
    body_quat: nbody x 4,
    body_ipos: nbody x 3,
    body_iquat: nbody x 4,
    body_mass: nbody x 1,
    body_subtreemass: nbody x 1,
    body_inertia: nbody x 3,
    body_invweight0: nbody x 2,
    body_gravcomp: nbody x 1,
    body_margin: nbody x 1,
    body_user: nbody x nuser_body,
    body_plugin: nbody x 1,
    body_contype: nbody x 1,
    body_conaffinity: nbody x 1,
    body_bvhadr: nbody x 1,
    body_bvhnum: nbody x 1,
    jnt_type: njnt x 1,
    jnt_qposadr: njnt x 1,
    jnt_dofadr: njnt x 1,
    jnt_bodyid: njnt x 1,
    jnt_group: njnt x 1,
    jnt_limited: njnt x 1,
    jnt_actfrclimited: njnt x 1,
    jnt_actgravcomp: njnt x 1,
    jnt_solref: njnt x 2,
    jnt_solimp: njnt x 5,
    jnt_pos: njnt x 3,
    jnt_axis: njnt x 3,
    jnt_stiffness: njnt x 1,
    jnt_range: njnt x 2,
    jnt_actfrcrange: njnt x 2,
    jnt_margin: njnt x 1,
    jnt_user: njnt x nuser_jnt,
    dof_bodyid: nv x 1,
    dof_jntid: nv x 1,
    dof_parentid: nv x 1,
    dof_treeid: nv x 1,
    dof_Madr: nv x 1,
    dof_simplenum: nv x 1,
    dof_solref: nv x 2,
    dof_solimp: nv x 5,
    dof_frictionloss: nv x 1,
    dof_armature: nv x 1,
    dof_damping: nv x 1,
    dof_invweight0: nv x 1,
    dof_M0: nv x 1,
    geom_type: ngeom x 1,
    geom_contype: ngeom x 1,
    geom_conaffinity: ngeom x 1,
    geom_condim: ngeom x 1,
    geom_bodyid: ngeom x 1,
    geom_dataid: ngeom x 1,
    geom_matid: ngeom x 1,
    geom_group: ngeom x 1,
    geom_priority: ngeom x 1,
    geom_plugin: ngeom x 1,
    geom_sameframe: ngeom x 1,
    geom_solmix: ngeom x 1,
    geom_solref: ngeom x 2,
    geom_solimp: ngeom x 5,
    geom_size: ngeom x 3,
    geom_aabb: ngeom x 6,
    geom_rbound: ngeom x 1,
    geom_pos: ngeom x 3,
    geom_quat: ngeom x 4,
    geom_friction: ngeom x 3,
    geom_margin: ngeom x 1,
    geom_gap: ngeom x 1,
    geom_fluid: ngeom x 12,
    geom_user: ngeom x nuser_geom,
    geom_rgba: ngeom x 4,
    site_type: nsite x 1,
    site_bodyid: nsite x 1,
    site_matid: nsite x 1,
    site_group: nsite x 1,
    site_sameframe: nsite x 1,
    site_size: nsite x 3,
    site_pos: nsite x 3,
    site_quat: nsite x 4,
    site_user: nsite x nuser_site,
    site_rgba: nsite x 4,
    cam_mode: ncam x 1,
    cam_bodyid: ncam x 1,
    cam_targetbodyid: ncam x 1,
    cam_pos: ncam x 3,
    cam_quat: ncam x 4,
    cam_poscom0: ncam x 3,
    cam_pos0: ncam x 3,
    cam_mat0: ncam x 9,
    cam_orthographic: ncam x 1,
    cam_fovy: ncam x 1,
    cam_ipd: ncam x 1,
    cam_resolution: ncam x 2,
    cam_sensorsize: ncam x 2,
    cam_intrinsic: ncam x 4,
    cam_user: ncam x nuser_cam,
    light_mode: nlight x 1,
    light_bodyid: nlight x 1,
    light_targetbodyid: nlight x 1,
    light_type: nlight x 1,
    light_texid: nlight x 1,
    light_castshadow: nlight x 1,
    light_bulbradius: nlight x 1,
    light_intensity: nlight x 1,
    light_range: nlight x 1,
    light_active: nlight x 1,
    light_pos: nlight x 3,
    light_dir: nlight x 3,
    light_poscom0: nlight x 3,
    light_pos0: nlight x 3,
    light_dir0: nlight x 3,
    light_attenuation: nlight x 3,
    light_cutoff: nlight x 1,
    light_exponent: nlight x 1,
    light_ambient: nlight x 3,
    light_diffuse: nlight x 3,
    light_specular: nlight x 3,
    flexedge_length0: nflexedge x 1,
    flexedge_invweight0: nflexedge x 1,
    flexedge_rigid: nflexedge x 1,
    mesh_vertadr: nmesh x 1,
    mesh_vertnum: nmesh x 1,
    mesh_faceadr: nmesh x 1,
    mesh_facenum: nmesh x 1,
    mesh_bvhadr: nmesh x 1,
    mesh_bvhnum: nmesh x 1,
    mesh_octadr: nmesh x 1,
    mesh_octnum: nmesh x 1,
    mesh_normaladr: nmesh x 1,
    mesh_normalnum: nmesh x 1,
    mesh_texcoordadr: nmesh x 1,
    mesh_texcoordnum: nmesh x 1,
    mesh_graphadr: nmesh x 1,
    mesh_scale: nmesh x 3,
    mesh_pos: nmesh x 3,
    mesh_quat: nmesh x 4,
    mesh_pathadr: nmesh x 1,
    hfield_size: nhfield x 4,
    hfield_nrow: nhfield x 1,
    hfield_ncol: nhfield x 1,
    hfield_adr: nhfield x 1,
    hfield_pathadr: nhfield x 1,
    tex_type: ntex x 1,
    tex_colorspace: ntex x 1,
    tex_height: ntex x 1,
    tex_width: ntex x 1,
    tex_nchannel: ntex x 1,
    tex_adr: ntex x 1,
    tex_pathadr: ntex x 1,
    mat_texid: nmat x 10,
    mat_texuniform: nmat x 1,
    mat_texrepeat: nmat x 2,
    mat_emission: nmat x 1,
    mat_specular: nmat x 1,
    mat_shininess: nmat x 1,
    mat_reflectance: nmat x 1,
    mat_metallic: nmat x 1,
    mat_roughness: nmat x 1,
    mat_rgba: nmat x 4,
    pair_dim: npair x 1,
    pair_geom1: npair x 1,
    pair_geom2: npair x 1,
    pair_signature: npair x 1,
    pair_solref: npair x 2,
    pair_solreffriction: npair x 2,
    pair_solimp: npair x 5,
    pair_margin: npair x 1,
    pair_gap: npair x 1,
    pair_friction: npair x 5,
    exclude_signature: nexclude x 1,
    eq_type: neq x 1,
    eq_obj1id: neq x 1,
    eq_obj2id: neq x 1,
    eq_objtype: neq x 1,
    eq_active0: neq x 1,
    eq_solref: neq x 2,
    eq_solimp: neq x 5,
    eq_data: neq x 11,
    tendon_adr: ntendon x 1,
    tendon_num: ntendon x 1,
    tendon_matid: ntendon x 1,
    tendon_group: ntendon x 1,
    tendon_limited: ntendon x 1,
    tendon_actfrclimited: ntendon x 1,
    tendon_width: ntendon x 1,
    tendon_solref_lim: ntendon x 2,
    tendon_solimp_lim: ntendon x 5,
    tendon_solref_fri: ntendon x 2,
    tendon_solimp_fri: ntendon x 5,
    tendon_range: ntendon x 2,
    tendon_actfrcrange: ntendon x 2,
    tendon_margin: ntendon x 1,
    tendon_stiffness: ntendon x 1,
    tendon_damping: ntendon x 1,
    tendon_armature: ntendon x 1,
    tendon_frictionloss: ntendon x 1,
    tendon_lengthspring: ntendon x 2,
    tendon_length0: ntendon x 1,
    tendon_invweight0: ntendon x 1,
    tendon_user: ntendon x nuser_tendon,
    tendon_rgba: ntendon x 4,
    actuator_trntype: nu x 1,
    actuator_dyntype: nu x 1,
    actuator_gaintype: nu x 1,
    actuator_biastype: nu x 1,
    actuator_trnid: nu x 2,
    actuator_actadr: nu x 1,
    actuator_actnum: nu x 1,
    actuator_group: nu x 1,
    actuator_ctrllimited: nu x 1,
    actuator_forcelimited: nu x 1,
    actuator_actlimited: nu x 1,
    actuator_dynprm: nu x 10,
    actuator_gainprm: nu x 10,
    actuator_biasprm: nu x 10,
    actuator_actearly: nu x 1,
    actuator_ctrlrange: nu x 2,
    actuator_forcerange: nu x 2,
    actuator_actrange: nu x 2,
    actuator_gear: nu x 6,
    actuator_cranklength: nu x 1,
    actuator_acc0: nu x 1,
    actuator_length0: nu x 1,
    actuator_lengthrange: nu x 2,
    actuator_user: nu x nuser_actuator,
    actuator_plugin: nu x 1,
    sensor_type: nsensor x 1,
    sensor_datatype: nsensor x 1,
    sensor_needstage: nsensor x 1,
    sensor_objtype: nsensor x 1,
    sensor_objid: nsensor x 1,
    sensor_reftype: nsensor x 1,
    sensor_refid: nsensor x 1,
    sensor_intprm: nsensor x 3,
    sensor_dim: nsensor x 1,
    sensor_adr: nsensor x 1,
    sensor_cutoff: nsensor x 1,
    sensor_noise: nsensor x 1,
    sensor_user: nsensor x nuser_sensor,
    sensor_plugin: nsensor x 1,
    qpos0: nq x 1,
    qpos_spring: nq x 1,
    wrap_type: nwrap x 1,
    wrap_objid: nwrap x 1,
    wrap_prm: nwrap x 1,
    plugin: nplugin x 1,
    plugin_stateadr: nplugin x 1,
    plugin_statenum: nplugin x 1,
    plugin_attr: npluginattr x 1,
    plugin_attradr: nplugin x 1,
    numeric_adr: nnumeric x 1,
    numeric_size: nnumeric x 1,
    numeric_data: nnumericdata x 1,
    text_adr: ntext x 1,
    text_size: ntext x 1,
    tuple_adr: ntuple x 1,
    tuple_size: ntuple x 1,
    tuple_objtype: ntupledata x 1,
    tuple_objid: ntupledata x 1,
    tuple_objprm: ntupledata x 1,
    key_time: nkey x 1,
    key_qpos: nkey x nq,
    key_qvel: nkey x nv,
    key_act: nkey x na,
    key_mpos: nkey x nmocap*3,
    key_mquat: nkey x nmocap*4,
    key_ctrl: nkey x nu,
    name_bodyadr: nbody x 1,
    name_jntadr: njnt x 1,
    name_geomadr: ngeom x 1,
    name_siteadr: nsite x 1,
    name_camadr: ncam x 1,
    name_lightadr: nlight x 1,
    name_flexadr: nflex x 1,
    name_meshadr: nmesh x 1,
    name_skinadr: nskin x 1,
    name_hfieldadr: nhfield x 1,
    name_texadr: ntex x 1,
    name_matadr: nmat x 1,
    name_pairadr: npair x 1,
    name_excludeadr: nexclude x 1,
    name_eqadr: neq x 1,
    name_tendonadr: ntendon x 1,
    name_actuatoradr: nu x 1,
    name_sensoradr: nsensor x 1,
    name_numericadr: nnumeric x 1,
    name_textadr: ntext x 1,
    name_tupleadr: ntuple x 1,
    name_keyadr: nkey x 1,
    name_pluginadr: nplugin x 1,
    B_rownnz: nbody x 1,
    B_rowadr: nbody x 1,
    B_colind: nB x 1,
    M_rownnz: nv x 1,
    M_rowadr: nv x 1,
    M_colind: nC x 1,
    mapM2M: nC x 1,
    D_rownnz: nv x 1,
    D_rowadr: nv x 1,
    D_diag: nv x 1,
    D_colind: nD x 1,
    mapM2D: nD x 1,
    mapD2M: nC x 1,
}
