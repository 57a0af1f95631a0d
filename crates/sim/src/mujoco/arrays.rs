//! Numeric arrays of a compiled model by name, for comparing models. The table omits the contents
//! of meshes, textures and height fields, their search trees, and most arrays of skins and flexible
//! bodies, which no LIBERO scene has. Names and sizes follow MuJoCo 3.3.7's `mjxmacro.h`.

use mujoco_rs::mujoco_c::mjModel;

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
    ($($rows:ident: $($name:ident $columns:tt $(* $factor:literal)?),+;)*) => {
        const NAMES: &[&str] = &[$($(stringify!($name),)+)*];

        /// Returns the array with this name; `None` if the table below does not list the name.
        pub(super) fn array(model: &mjModel, name: &str) -> Option<ModelArray> {
            match name {
                $($(
                    stringify!($name) => {
                        let rows = model.$rows as usize;
                        let columns = columns!(model, $columns) $(* $factor)?;
                        let values = read(model.$name.cast_const(), rows * columns);
                        Some(ModelArray { rows, values })
                    }
                )+)*
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

// Length along the first axis: names, each with its values per element.
arrays! {
    nbody: body_parentid 1, body_rootid 1, body_weldid 1, body_mocapid 1, body_jntnum 1,
        body_jntadr 1, body_dofnum 1, body_dofadr 1, body_treeid 1, body_geomnum 1, body_geomadr 1,
        body_simple 1, body_sameframe 1, body_pos 3, body_quat 4, body_ipos 3, body_iquat 4,
        body_mass 1, body_subtreemass 1, body_inertia 3, body_invweight0 2, body_gravcomp 1,
        body_margin 1, body_user nuser_body, body_plugin 1, body_contype 1, body_conaffinity 1,
        body_bvhadr 1, body_bvhnum 1;
    njnt: jnt_type 1, jnt_qposadr 1, jnt_dofadr 1, jnt_bodyid 1, jnt_group 1, jnt_limited 1,
        jnt_actfrclimited 1, jnt_actgravcomp 1, jnt_solref 2, jnt_solimp 5, jnt_pos 3, jnt_axis 3,
        jnt_stiffness 1, jnt_range 2, jnt_actfrcrange 2, jnt_margin 1, jnt_user nuser_jnt;
    nv: dof_bodyid 1, dof_jntid 1, dof_parentid 1, dof_treeid 1, dof_Madr 1, dof_simplenum 1,
        dof_solref 2, dof_solimp 5, dof_frictionloss 1, dof_armature 1, dof_damping 1,
        dof_invweight0 1, dof_M0 1;
    ngeom: geom_type 1, geom_contype 1, geom_conaffinity 1, geom_condim 1, geom_bodyid 1,
        geom_dataid 1, geom_matid 1, geom_group 1, geom_priority 1, geom_plugin 1, geom_sameframe 1,
        geom_solmix 1, geom_solref 2, geom_solimp 5, geom_size 3, geom_aabb 6, geom_rbound 1,
        geom_pos 3, geom_quat 4, geom_friction 3, geom_margin 1, geom_gap 1, geom_fluid 12,
        geom_user nuser_geom, geom_rgba 4;
    nsite: site_type 1, site_bodyid 1, site_matid 1, site_group 1, site_sameframe 1, site_size 3,
        site_pos 3, site_quat 4, site_user nuser_site, site_rgba 4;
    ncam: cam_mode 1, cam_bodyid 1, cam_targetbodyid 1, cam_pos 3, cam_quat 4, cam_poscom0 3,
        cam_pos0 3, cam_mat0 9, cam_orthographic 1, cam_fovy 1, cam_ipd 1, cam_resolution 2,
        cam_sensorsize 2, cam_intrinsic 4, cam_user nuser_cam;
    nlight: light_mode 1, light_bodyid 1, light_targetbodyid 1, light_type 1, light_texid 1,
        light_castshadow 1, light_bulbradius 1, light_intensity 1, light_range 1, light_active 1,
        light_pos 3, light_dir 3, light_poscom0 3, light_pos0 3, light_dir0 3, light_attenuation 3,
        light_cutoff 1, light_exponent 1, light_ambient 3, light_diffuse 3, light_specular 3;
    nflexedge: flexedge_length0 1, flexedge_invweight0 1, flexedge_rigid 1;
    nmesh: mesh_vertadr 1, mesh_vertnum 1, mesh_faceadr 1, mesh_facenum 1, mesh_bvhadr 1,
        mesh_bvhnum 1, mesh_octadr 1, mesh_octnum 1, mesh_normaladr 1, mesh_normalnum 1,
        mesh_texcoordadr 1, mesh_texcoordnum 1, mesh_graphadr 1, mesh_scale 3, mesh_pos 3,
        mesh_quat 4, mesh_pathadr 1;
    nhfield: hfield_size 4, hfield_nrow 1, hfield_ncol 1, hfield_adr 1, hfield_pathadr 1;
    ntex: tex_type 1, tex_colorspace 1, tex_height 1, tex_width 1, tex_nchannel 1, tex_adr 1,
        tex_pathadr 1;
    nmat: mat_texid 10, mat_texuniform 1, mat_texrepeat 2, mat_emission 1, mat_specular 1,
        mat_shininess 1, mat_reflectance 1, mat_metallic 1, mat_roughness 1, mat_rgba 4;
    npair: pair_dim 1, pair_geom1 1, pair_geom2 1, pair_signature 1, pair_solref 2,
        pair_solreffriction 2, pair_solimp 5, pair_margin 1, pair_gap 1, pair_friction 5;
    nexclude: exclude_signature 1;
    neq: eq_type 1, eq_obj1id 1, eq_obj2id 1, eq_objtype 1, eq_active0 1, eq_solref 2, eq_solimp 5,
        eq_data 11;
    ntendon: tendon_adr 1, tendon_num 1, tendon_matid 1, tendon_group 1, tendon_limited 1,
        tendon_actfrclimited 1, tendon_width 1, tendon_solref_lim 2, tendon_solimp_lim 5,
        tendon_solref_fri 2, tendon_solimp_fri 5, tendon_range 2, tendon_actfrcrange 2,
        tendon_margin 1, tendon_stiffness 1, tendon_damping 1, tendon_armature 1,
        tendon_frictionloss 1, tendon_lengthspring 2, tendon_length0 1, tendon_invweight0 1,
        tendon_user nuser_tendon, tendon_rgba 4;
    nu: actuator_trntype 1, actuator_dyntype 1, actuator_gaintype 1, actuator_biastype 1,
        actuator_trnid 2, actuator_actadr 1, actuator_actnum 1, actuator_group 1,
        actuator_ctrllimited 1, actuator_forcelimited 1, actuator_actlimited 1, actuator_dynprm 10,
        actuator_gainprm 10, actuator_biasprm 10, actuator_actearly 1, actuator_ctrlrange 2,
        actuator_forcerange 2, actuator_actrange 2, actuator_gear 6, actuator_cranklength 1,
        actuator_acc0 1, actuator_length0 1, actuator_lengthrange 2, actuator_user nuser_actuator,
        actuator_plugin 1;
    nsensor: sensor_type 1, sensor_datatype 1, sensor_needstage 1, sensor_objtype 1, sensor_objid 1,
        sensor_reftype 1, sensor_refid 1, sensor_intprm 3, sensor_dim 1, sensor_adr 1,
        sensor_cutoff 1, sensor_noise 1, sensor_user nuser_sensor, sensor_plugin 1;
    nq: qpos0 1, qpos_spring 1;
    nwrap: wrap_type 1, wrap_objid 1, wrap_prm 1;
    nplugin: plugin 1, plugin_stateadr 1, plugin_statenum 1;
    npluginattr: plugin_attr 1;
    nplugin: plugin_attradr 1;
    nnumeric: numeric_adr 1, numeric_size 1;
    nnumericdata: numeric_data 1;
    ntext: text_adr 1, text_size 1;
    ntuple: tuple_adr 1, tuple_size 1;
    ntupledata: tuple_objtype 1, tuple_objid 1, tuple_objprm 1;
    nkey: key_time 1, key_qpos nq, key_qvel nv, key_act na, key_mpos nmocap * 3,
        key_mquat nmocap * 4, key_ctrl nu;
    nbody: name_bodyadr 1;
    njnt: name_jntadr 1;
    ngeom: name_geomadr 1;
    nsite: name_siteadr 1;
    ncam: name_camadr 1;
    nlight: name_lightadr 1;
    nflex: name_flexadr 1;
    nmesh: name_meshadr 1;
    nskin: name_skinadr 1;
    nhfield: name_hfieldadr 1;
    ntex: name_texadr 1;
    nmat: name_matadr 1;
    npair: name_pairadr 1;
    nexclude: name_excludeadr 1;
    neq: name_eqadr 1;
    ntendon: name_tendonadr 1;
    nu: name_actuatoradr 1;
    nsensor: name_sensoradr 1;
    nnumeric: name_numericadr 1;
    ntext: name_textadr 1;
    ntuple: name_tupleadr 1;
    nkey: name_keyadr 1;
    nplugin: name_pluginadr 1;
    nbody: B_rownnz 1, B_rowadr 1;
    nB: B_colind 1;
    nv: M_rownnz 1, M_rowadr 1;
    nC: M_colind 1, mapM2M 1;
    nv: D_rownnz 1, D_rowadr 1, D_diag 1;
    nD: D_colind 1, mapM2D 1;
    nC: mapD2M 1;
}
