//! Definitions of what veneer publishes and serves.

/// The text of a file of this package as a section.
macro_rules! own_section {
    ($name:literal) => {
        concat!(
            "================================================================================\n",
            "MSG: veneer/",
            $name,
            "\n",
            include_str!(concat!("../../../msg/", $name, ".msg"))
        )
    };
}
macro_rules! mesh_face_cluster {
    () => {
        section!(
            "mesh_msgs/MeshFaceCluster",
            "uint32[] face_indices",
            "string label"
        )
    };
}
/// `mesh_msgs/MeshMaterialsStamped` and all that it uses but the header.
macro_rules! mesh_materials {
    () => {
        concat!(
            section!(
                "mesh_msgs/MeshMaterials",
                "mesh_msgs/MeshFaceCluster[] clusters",
                "mesh_msgs/MeshMaterial[] materials",
                "uint32[] cluster_materials",
                "mesh_msgs/MeshVertexTexCoords[] vertex_tex_coords"
            ),
            mesh_face_cluster!(),
            section!(
                "mesh_msgs/MeshMaterial",
                "uint32 texture_index",
                "std_msgs/ColorRGBA color",
                "bool has_texture"
            ),
            section!("mesh_msgs/MeshVertexTexCoords", "float32 u", "float32 v"),
            color_rgba!()
        )
    };
}
macro_rules! mesh_geometry {
    () => {
        concat!(
            section!(
                "mesh_msgs/MeshGeometry",
                "geometry_msgs/Point[] vertices",
                "geometry_msgs/Point[] vertex_normals",
                "mesh_msgs/MeshTriangleIndices[] faces"
            ),
            section!("mesh_msgs/MeshTriangleIndices", "uint32[3] vertex_indices"),
            point!()
        )
    };
}
macro_rules! mesh_vertex_colors {
    () => {
        concat!(
            section!(
                "mesh_msgs/MeshVertexColors",
                "std_msgs/ColorRGBA[] vertex_colors"
            ),
            color_rgba!()
        )
    };
}
macro_rules! mesh_texture_fields {
    () => {
        concat!(
            "string uuid\n",
            "uint32 texture_index\n",
            "sensor_msgs/Image image\n"
        )
    };
}
macro_rules! image {
    () => {
        concat!(
            section!(
                "sensor_msgs/Image",
                "std_msgs/Header header",
                "uint32 height",
                "uint32 width",
                "string encoding",
                "uint8 is_bigendian",
                "uint32 step",
                "uint8[] data"
            ),
            header!()
        )
    };
}
macro_rules! key_value {
    () => {
        section!("diagnostic_msgs/KeyValue", "string key", "string value")
    };
}
macro_rules! state {
    () => {
        section!(
            "lifecycle_msgs/State",
            "uint8 PRIMARY_STATE_UNKNOWN = 0",
            "uint8 PRIMARY_STATE_UNCONFIGURED = 1",
            "uint8 PRIMARY_STATE_INACTIVE = 2",
            "uint8 PRIMARY_STATE_ACTIVE = 3",
            "uint8 PRIMARY_STATE_FINALIZED = 4",
            "uint8 TRANSITION_STATE_CONFIGURING = 10",
            "uint8 TRANSITION_STATE_CLEANINGUP = 11",
            "uint8 TRANSITION_STATE_SHUTTINGDOWN = 12",
            "uint8 TRANSITION_STATE_ACTIVATING = 13",
            "uint8 TRANSITION_STATE_DEACTIVATING = 14",
            "uint8 TRANSITION_STATE_ERRORPROCESSING = 15",
            "uint8 id",
            "string label"
        )
    };
}
macro_rules! transition {
    () => {
        section!(
            "lifecycle_msgs/Transition",
            "uint8 TRANSITION_CREATE = 0",
            "uint8 TRANSITION_CONFIGURE = 1",
            "uint8 TRANSITION_CLEANUP = 2",
            "uint8 TRANSITION_ACTIVATE = 3",
            "uint8 TRANSITION_DEACTIVATE = 4",
            "uint8 TRANSITION_UNCONFIGURED_SHUTDOWN = 5",
            "uint8 TRANSITION_INACTIVE_SHUTDOWN = 6",
            "uint8 TRANSITION_ACTIVE_SHUTDOWN = 7",
            "uint8 TRANSITION_DESTROY = 8",
            "uint8 TRANSITION_ON_CONFIGURE_SUCCESS = 10",
            "uint8 TRANSITION_ON_CONFIGURE_FAILURE = 11",
            "uint8 TRANSITION_ON_CONFIGURE_ERROR = 12",
            "uint8 TRANSITION_ON_CLEANUP_SUCCESS = 20",
            "uint8 TRANSITION_ON_CLEANUP_FAILURE = 21",
            "uint8 TRANSITION_ON_CLEANUP_ERROR = 22",
            "uint8 TRANSITION_ON_ACTIVATE_SUCCESS = 30",
            "uint8 TRANSITION_ON_ACTIVATE_FAILURE = 31",
            "uint8 TRANSITION_ON_ACTIVATE_ERROR = 32",
            "uint8 TRANSITION_ON_DEACTIVATE_SUCCESS = 40",
            "uint8 TRANSITION_ON_DEACTIVATE_FAILURE = 41",
            "uint8 TRANSITION_ON_DEACTIVATE_ERROR = 42",
            "uint8 TRANSITION_ON_SHUTDOWN_SUCCESS = 50",
            "uint8 TRANSITION_ON_SHUTDOWN_FAILURE = 51",
            "uint8 TRANSITION_ON_SHUTDOWN_ERROR = 52",
            "uint8 TRANSITION_ON_ERROR_SUCCESS = 60",
            "uint8 TRANSITION_ON_ERROR_FAILURE = 61",
            "uint8 TRANSITION_ON_ERROR_ERROR = 62",
            "uint8 TRANSITION_CALLBACK_SUCCESS = 97",
            "uint8 TRANSITION_CALLBACK_FAILURE = 98",
            "uint8 TRANSITION_CALLBACK_ERROR = 99",
            "uint8 id",
            "string label"
        )
    };
}

pub(crate) const TEXTURED_MESH_BLOCK: &str = concat!(
    include_str!("../../../msg/TexturedMeshBlock.msg"),
    header!(),
    own_section!("TexturedChart"),
    point!(),
    own_section!("TextureTile")
);
pub(crate) const STATUS: &str = concat!(
    include_str!("../../../msg/Status.msg"),
    header!(),
    own_section!("TopicStatus"),
    own_section!("OutputStatus"),
    own_section!("QueueStatus"),
    own_section!("StageStatus")
);
pub(crate) const POSE_CORRECTIONS: &str = concat!(
    include_str!("../../../msg/PoseCorrections.msg"),
    header!(),
    own_section!("PoseCorrection"),
    pose!()
);
pub(crate) const PATH: &str = concat!(
    "std_msgs/Header header\n",
    "geometry_msgs/PoseStamped[] poses\n",
    header!(),
    section!(
        "geometry_msgs/PoseStamped",
        "std_msgs/Header header",
        "geometry_msgs/Pose pose"
    ),
    pose!()
);
pub(crate) const POSE_ARRAY: &str = concat!(
    "std_msgs/Header header\n",
    "geometry_msgs/Pose[] poses\n",
    header!(),
    pose!()
);
pub(crate) const CLOCK: &str = concat!("builtin_interfaces/Time clock\n", time!());
pub(crate) const LOG: &str = concat!(
    "uint8 DEBUG=10\n",
    "uint8 INFO=20\n",
    "uint8 WARN=30\n",
    "uint8 ERROR=40\n",
    "uint8 FATAL=50\n",
    "builtin_interfaces/Time stamp\n",
    "uint8 level\n",
    "string name\n",
    "string msg\n",
    "string file\n",
    "string function\n",
    "uint32 line\n",
    time!()
);
pub(crate) const DIAGNOSTIC_ARRAY: &str = concat!(
    "std_msgs/Header header\n",
    "diagnostic_msgs/DiagnosticStatus[] status\n",
    header!(),
    section!(
        "diagnostic_msgs/DiagnosticStatus",
        "byte OK=0",
        "byte WARN=1",
        "byte ERROR=2",
        "byte STALE=3",
        "byte level",
        "string name",
        "string message",
        "string hardware_id",
        "diagnostic_msgs/KeyValue[] values"
    ),
    key_value!()
);
pub(crate) const MESH_MATERIALS_STAMPED: &str = concat!(
    "std_msgs/Header header\n",
    "string uuid\n",
    "mesh_msgs/MeshMaterials mesh_materials\n",
    header!(),
    mesh_materials!()
);
pub(crate) const MESH_VERTEX_COLORS_STAMPED: &str = concat!(
    "std_msgs/Header header\n",
    "string uuid\n",
    "mesh_msgs/MeshVertexColors mesh_vertex_colors\n",
    header!(),
    mesh_vertex_colors!()
);
pub(crate) const MESH_TEXTURE: &str = concat!(mesh_texture_fields!(), image!());
pub(crate) const SCENE_UPDATE: &str = concat!(
    "foxglove_msgs/SceneEntityDeletion[] deletions\n",
    "foxglove_msgs/SceneEntity[] entities\n",
    section!(
        "foxglove_msgs/SceneEntityDeletion",
        "builtin_interfaces/Time timestamp",
        "uint8 MATCHING_ID=0",
        "uint8 ALL=1",
        "uint8 type",
        "string id"
    ),
    section!(
        "foxglove_msgs/SceneEntity",
        "builtin_interfaces/Time timestamp",
        "string frame_id",
        "string id",
        "builtin_interfaces/Duration lifetime",
        "bool frame_locked",
        "foxglove_msgs/KeyValuePair[] metadata",
        "foxglove_msgs/ArrowPrimitive[] arrows",
        "foxglove_msgs/CubePrimitive[] cubes",
        "foxglove_msgs/SpherePrimitive[] spheres",
        "foxglove_msgs/CylinderPrimitive[] cylinders",
        "foxglove_msgs/LinePrimitive[] lines",
        "foxglove_msgs/TriangleListPrimitive[] triangles",
        "foxglove_msgs/TextPrimitive[] texts",
        "foxglove_msgs/ModelPrimitive[] models"
    ),
    section!("foxglove_msgs/KeyValuePair", "string key", "string value"),
    section!(
        "foxglove_msgs/ArrowPrimitive",
        "geometry_msgs/Pose pose",
        "float64 shaft_length",
        "float64 shaft_diameter",
        "float64 head_length",
        "float64 head_diameter",
        "foxglove_msgs/Color color"
    ),
    section!(
        "foxglove_msgs/CubePrimitive",
        "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 size",
        "foxglove_msgs/Color color"
    ),
    section!(
        "foxglove_msgs/SpherePrimitive",
        "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 size",
        "foxglove_msgs/Color color"
    ),
    section!(
        "foxglove_msgs/CylinderPrimitive",
        "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 size",
        "float64 bottom_scale",
        "float64 top_scale",
        "foxglove_msgs/Color color"
    ),
    section!(
        "foxglove_msgs/LinePrimitive",
        "uint8 LINE_STRIP=0",
        "uint8 LINE_LOOP=1",
        "uint8 LINE_LIST=2",
        "uint8 type",
        "geometry_msgs/Pose pose",
        "float64 thickness",
        "bool scale_invariant",
        "geometry_msgs/Point[] points",
        "foxglove_msgs/Color color",
        "foxglove_msgs/Color[] colors",
        "uint32[] indices"
    ),
    section!(
        "foxglove_msgs/TriangleListPrimitive",
        "geometry_msgs/Pose pose",
        "geometry_msgs/Point[] points",
        "foxglove_msgs/Color color",
        "foxglove_msgs/Color[] colors",
        "uint32[] indices"
    ),
    section!(
        "foxglove_msgs/TextPrimitive",
        "geometry_msgs/Pose pose",
        "bool billboard",
        "float64 font_size",
        "bool scale_invariant",
        "foxglove_msgs/Color color",
        "string text"
    ),
    section!(
        "foxglove_msgs/ModelPrimitive",
        "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 scale",
        "foxglove_msgs/Color color",
        "bool override_color",
        "string url",
        "string media_type",
        "uint8[] data"
    ),
    section!(
        "foxglove_msgs/Color",
        "float64 r",
        "float64 g",
        "float64 b",
        "float64 a"
    ),
    pose!(),
    vector3!(),
    time!(),
    duration!()
);
pub(crate) const TRANSITION_EVENT: &str = concat!(
    "uint64 timestamp\n",
    "lifecycle_msgs/Transition transition\n",
    "lifecycle_msgs/State start_state\n",
    "lifecycle_msgs/State goal_state\n",
    transition!(),
    state!()
);

pub(crate) const STATE_ONLY: &str = concat!("lifecycle_msgs/State current_state\n", state!());
pub(crate) const STATES_ONLY: &str = concat!("lifecycle_msgs/State[] available_states\n", state!());
pub(crate) const TRANSITIONS_ONLY: &str = concat!(
    "lifecycle_msgs/TransitionDescription[] available_transitions\n",
    section!(
        "lifecycle_msgs/TransitionDescription",
        "lifecycle_msgs/Transition transition",
        "lifecycle_msgs/State start_state",
        "lifecycle_msgs/State goal_state"
    ),
    transition!(),
    state!()
);
pub(crate) const TRANSITION_ONLY: &str =
    concat!("lifecycle_msgs/Transition transition\n", transition!());
pub(crate) const GEOMETRY_RESPONSE: &str = concat!(
    "mesh_msgs/MeshGeometryStamped mesh_geometry_stamped\n",
    section!(
        "mesh_msgs/MeshGeometryStamped",
        "std_msgs/Header header",
        "string uuid",
        "mesh_msgs/MeshGeometry mesh_geometry"
    ),
    header!(),
    mesh_geometry!()
);
pub(crate) const MATERIALS_RESPONSE: &str = concat!(
    "mesh_msgs/MeshMaterialsStamped mesh_materials_stamped\n",
    section!(
        "mesh_msgs/MeshMaterialsStamped",
        "std_msgs/Header header",
        "string uuid",
        "mesh_msgs/MeshMaterials mesh_materials"
    ),
    header!(),
    mesh_materials!()
);
pub(crate) const VERTEX_COLORS_RESPONSE: &str = concat!(
    "mesh_msgs/MeshVertexColorsStamped mesh_vertex_colors_stamped\n",
    section!(
        "mesh_msgs/MeshVertexColorsStamped",
        "std_msgs/Header header",
        "string uuid",
        "mesh_msgs/MeshVertexColors mesh_vertex_colors"
    ),
    header!(),
    mesh_vertex_colors!()
);
pub(crate) const TEXTURE_RESPONSE: &str = concat!(
    "mesh_msgs/MeshTexture texture\n",
    "================================================================================\n",
    "MSG: mesh_msgs/MeshTexture\n",
    mesh_texture_fields!(),
    image!()
);
