//! Message definitions as `ros2msg` text: the message's own fields, then a section for each type
//! it uses, once, directly or through others. Comments of the originals are left out.

/// A section for a used type.
macro_rules! section {
    ($name:literal, $($line:literal),* $(,)?) => {
        concat!(
            "================================================================================\n",
            "MSG: ", $name, "\n", $($line, "\n"),*
        )
    };
}
macro_rules! time {
    () => {
        section!("builtin_interfaces/Time", "int32 sec", "uint32 nanosec")
    };
}
macro_rules! duration {
    () => {
        section!("builtin_interfaces/Duration", "int32 sec", "uint32 nanosec")
    };
}
/// `std_msgs/Header` and what it uses.
macro_rules! header {
    () => {
        concat!(
            section!(
                "std_msgs/Header",
                "builtin_interfaces/Time stamp",
                "string frame_id"
            ),
            time!()
        )
    };
}
macro_rules! point {
    () => {
        section!("geometry_msgs/Point", "float64 x", "float64 y", "float64 z")
    };
}
macro_rules! point32 {
    () => {
        section!(
            "geometry_msgs/Point32",
            "float32 x",
            "float32 y",
            "float32 z"
        )
    };
}
macro_rules! vector3 {
    () => {
        section!(
            "geometry_msgs/Vector3",
            "float64 x",
            "float64 y",
            "float64 z"
        )
    };
}
macro_rules! quaternion {
    () => {
        section!(
            "geometry_msgs/Quaternion",
            "float64 x 0",
            "float64 y 0",
            "float64 z 0",
            "float64 w 1"
        )
    };
}
/// `geometry_msgs/Pose` and what it uses.
macro_rules! pose {
    () => {
        concat!(
            section!(
                "geometry_msgs/Pose",
                "geometry_msgs/Point position",
                "geometry_msgs/Quaternion orientation"
            ),
            point!(),
            quaternion!()
        )
    };
}
/// `geometry_msgs/PoseWithCovariance` and what it uses.
macro_rules! pose_with_covariance {
    () => {
        concat!(
            section!(
                "geometry_msgs/PoseWithCovariance",
                "geometry_msgs/Pose pose",
                "float64[36] covariance"
            ),
            pose!()
        )
    };
}
/// `geometry_msgs/TwistWithCovariance` and what it uses.
macro_rules! twist_with_covariance {
    () => {
        concat!(
            section!(
                "geometry_msgs/TwistWithCovariance",
                "geometry_msgs/Twist twist",
                "float64[36] covariance"
            ),
            section!(
                "geometry_msgs/Twist",
                "geometry_msgs/Vector3 linear",
                "geometry_msgs/Vector3 angular"
            ),
            vector3!()
        )
    };
}
/// `geometry_msgs/TransformStamped` and what it uses, without the header.
macro_rules! transform_stamped {
    () => {
        concat!(
            section!(
                "geometry_msgs/TransformStamped",
                "std_msgs/Header header",
                "string child_frame_id",
                "geometry_msgs/Transform transform"
            ),
            section!(
                "geometry_msgs/Transform",
                "geometry_msgs/Vector3 translation",
                "geometry_msgs/Quaternion rotation"
            ),
            vector3!(),
            quaternion!()
        )
    };
}
macro_rules! color_rgba {
    () => {
        section!(
            "std_msgs/ColorRGBA",
            "float32 r",
            "float32 g",
            "float32 b",
            "float32 a"
        )
    };
}
macro_rules! marker_fields {
    () => {
        concat!(
            "int32 ARROW=0\n",
            "int32 CUBE=1\n",
            "int32 SPHERE=2\n",
            "int32 CYLINDER=3\n",
            "int32 LINE_STRIP=4\n",
            "int32 LINE_LIST=5\n",
            "int32 CUBE_LIST=6\n",
            "int32 SPHERE_LIST=7\n",
            "int32 POINTS=8\n",
            "int32 TEXT_VIEW_FACING=9\n",
            "int32 MESH_RESOURCE=10\n",
            "int32 TRIANGLE_LIST=11\n",
            "int32 ARROW_STRIP=12\n",
            "int32 ADD=0\n",
            "int32 MODIFY=0\n",
            "int32 DELETE=2\n",
            "int32 DELETEALL=3\n",
            "std_msgs/Header header\n",
            "string ns\n",
            "int32 id\n",
            "int32 type\n",
            "int32 action\n",
            "geometry_msgs/Pose pose\n",
            "geometry_msgs/Vector3 scale\n",
            "std_msgs/ColorRGBA color\n",
            "builtin_interfaces/Duration lifetime\n",
            "bool frame_locked\n",
            "geometry_msgs/Point[] points\n",
            "std_msgs/ColorRGBA[] colors\n",
            "string texture_resource\n",
            "sensor_msgs/CompressedImage texture\n",
            "visualization_msgs/UVCoordinate[] uv_coordinates\n",
            "string text\n",
            "string mesh_resource\n",
            "visualization_msgs/MeshFile mesh_file\n",
            "bool mesh_use_embedded_materials\n"
        )
    };
}
/// What `visualization_msgs/Marker` uses.
macro_rules! marker_dependencies {
    () => {
        concat!(
            header!(),
            pose!(),
            vector3!(),
            color_rgba!(),
            duration!(),
            section!(
                "sensor_msgs/CompressedImage",
                "std_msgs/Header header",
                "string format",
                "uint8[] data"
            ),
            section!("visualization_msgs/UVCoordinate", "float32 u", "float32 v"),
            section!(
                "visualization_msgs/MeshFile",
                "string filename",
                "uint8[] data"
            )
        )
    };
}

pub(super) const IMAGE: &str = concat!(
    "std_msgs/Header header\n",
    "uint32 height\n",
    "uint32 width\n",
    "string encoding\n",
    "uint8 is_bigendian\n",
    "uint32 step\n",
    "uint8[] data\n",
    header!()
);
pub(super) const COMPRESSED_IMAGE: &str = concat!(
    "std_msgs/Header header\n",
    "string format\n",
    "uint8[] data\n",
    header!()
);
pub(super) const CAMERA_INFO: &str = concat!(
    "std_msgs/Header header\n",
    "uint32 height\n",
    "uint32 width\n",
    "string distortion_model\n",
    "float64[] d\n",
    "float64[9] k\n",
    "float64[9] r\n",
    "float64[12] p\n",
    "uint32 binning_x\n",
    "uint32 binning_y\n",
    "sensor_msgs/RegionOfInterest roi\n",
    header!(),
    section!(
        "sensor_msgs/RegionOfInterest",
        "uint32 x_offset",
        "uint32 y_offset",
        "uint32 height",
        "uint32 width",
        "bool do_rectify"
    )
);
pub(super) const TF_MESSAGE: &str = concat!(
    "geometry_msgs/TransformStamped[] transforms\n",
    transform_stamped!(),
    header!()
);
pub(super) const POSE_STAMPED: &str = concat!(
    "std_msgs/Header header\n",
    "geometry_msgs/Pose pose\n",
    header!(),
    pose!()
);
pub(super) const POSE_WITH_COVARIANCE_STAMPED: &str = concat!(
    "std_msgs/Header header\n",
    "geometry_msgs/PoseWithCovariance pose\n",
    header!(),
    pose_with_covariance!()
);
pub(super) const ODOMETRY: &str = concat!(
    "std_msgs/Header header\n",
    "string child_frame_id\n",
    "geometry_msgs/PoseWithCovariance pose\n",
    "geometry_msgs/TwistWithCovariance twist\n",
    header!(),
    pose_with_covariance!(),
    twist_with_covariance!()
);
pub(super) const MESH_GEOMETRY_STAMPED: &str = concat!(
    "std_msgs/Header header\n",
    "string uuid\n",
    "mesh_msgs/MeshGeometry mesh_geometry\n",
    header!(),
    section!(
        "mesh_msgs/MeshGeometry",
        "geometry_msgs/Point[] vertices",
        "geometry_msgs/Point[] vertex_normals",
        "mesh_msgs/MeshTriangleIndices[] faces"
    ),
    section!("mesh_msgs/MeshTriangleIndices", "uint32[3] vertex_indices"),
    point!()
);
pub(super) const SHAPE_MESH: &str = concat!(
    "shape_msgs/MeshTriangle[] triangles\n",
    "geometry_msgs/Point[] vertices\n",
    section!("shape_msgs/MeshTriangle", "uint32[3] vertex_indices"),
    point!()
);
pub(super) const MARKER: &str = concat!(marker_fields!(), marker_dependencies!());
pub(super) const MARKER_ARRAY: &str = concat!(
    "visualization_msgs/Marker[] markers\n",
    "================================================================================\n",
    "MSG: visualization_msgs/Marker\n",
    marker_fields!(),
    marker_dependencies!()
);
pub(super) const NVBLOX_MESH: &str = concat!(
    "std_msgs/Header header\n",
    "float32 block_size_m\n",
    "nvblox_msgs/Index3D[] block_indices\n",
    "nvblox_msgs/MeshBlock[] blocks\n",
    "bool clear\n",
    header!(),
    section!("nvblox_msgs/Index3D", "int32 x", "int32 y", "int32 z"),
    section!(
        "nvblox_msgs/MeshBlock",
        "geometry_msgs/Point32[] vertices",
        "geometry_msgs/Point32[] normals",
        "std_msgs/ColorRGBA[] colors",
        "int32[] triangles"
    ),
    point32!(),
    color_rgba!()
);
pub(super) const MESH_UPDATE: &str = concat!(
    "std_msgs/Header header\n",
    "uint64 revision\n",
    "bool clear\n",
    "veneer/MeshBlock[] blocks\n",
    header!(),
    section!(
        "veneer/MeshBlock",
        "int64 key",
        "geometry_msgs/Point32[] vertices",
        "uint32[] triangles"
    ),
    point32!()
);

mod output;

pub(super) use output::*;
