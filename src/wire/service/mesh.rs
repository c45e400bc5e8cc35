//! Services of `mesh_msgs`, by which mesh_tools fetches what it shows.

use super::{Service, empty_message, plain_message};
use crate::wire::cdr::{CdrReader, CdrWriter};
use crate::wire::error::WireError;
use crate::wire::{
    MeshGeometryStamped, MeshMaterialsStamped, MeshTexture, MeshVertexColorsStamped, Message,
    schema,
};

empty_message!(
    /// Request of `mesh_msgs/GetUUIDs`.
    GetUuidsRequest,
    "mesh_msgs/srv/GetUUIDs_Request"
);
plain_message!(
    /// Response of `mesh_msgs/GetUUIDs`.
    GetUuidsResponse,
    "mesh_msgs/srv/GetUUIDs_Response",
    "string[] uuids\n",
    {
        /// Names of all meshes.
        uuids: Vec<String>
    }
);
plain_message!(
    /// Request of `mesh_msgs/GetGeometry`.
    GetGeometryRequest,
    "mesh_msgs/srv/GetGeometry_Request",
    "string uuid\n",
    {
        /// Name of the mesh.
        uuid: String
    }
);
plain_message!(
    /// Request of `mesh_msgs/GetMaterials`.
    GetMaterialsRequest,
    "mesh_msgs/srv/GetMaterials_Request",
    "string uuid\n",
    {
        /// Name of the mesh.
        uuid: String
    }
);
plain_message!(
    /// Request of `mesh_msgs/GetVertexColors`.
    GetVertexColorsRequest,
    "mesh_msgs/srv/GetVertexColors_Request",
    "string uuid\n",
    {
        /// Name of the mesh.
        uuid: String
    }
);
plain_message!(
    /// Request of `mesh_msgs/GetTexture`.
    GetTextureRequest,
    "mesh_msgs/srv/GetTexture_Request",
    "string uuid\nuint32 texture_index\n",
    {
        /// Name of the mesh.
        uuid: String,
        /// Which texture of it.
        texture_index: u32
    }
);

/// A response that holds one message and nothing else.
macro_rules! wrapping_response {
    ($(#[$doc:meta])* $name:ident, $inner:ident, $type_name:literal, $schema:expr) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name<'a>(pub $inner<'a>);

        impl<'a> Message<'a> for $name<'a> {
            const TYPE_NAME: &'static str = $type_name;
            const SCHEMA: &'static str = $schema;

            fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
                $inner::read(reader).map(Self)
            }

            fn write(&self, writer: &mut CdrWriter) {
                self.0.write(writer);
            }
        }
    };
}
wrapping_response!(
    /// Response of `mesh_msgs/GetGeometry`.
    GetGeometryResponse,
    MeshGeometryStamped,
    "mesh_msgs/srv/GetGeometry_Response",
    schema::GEOMETRY_RESPONSE
);
wrapping_response!(
    /// Response of `mesh_msgs/GetMaterials`.
    GetMaterialsResponse,
    MeshMaterialsStamped,
    "mesh_msgs/srv/GetMaterials_Response",
    schema::MATERIALS_RESPONSE
);
wrapping_response!(
    /// Response of `mesh_msgs/GetVertexColors`.
    GetVertexColorsResponse,
    MeshVertexColorsStamped,
    "mesh_msgs/srv/GetVertexColors_Response",
    schema::VERTEX_COLORS_RESPONSE
);
wrapping_response!(
    /// Response of `mesh_msgs/GetTexture`.
    GetTextureResponse,
    MeshTexture,
    "mesh_msgs/srv/GetTexture_Response",
    schema::TEXTURE_RESPONSE
);

/// `mesh_msgs/GetUUIDs`.
#[derive(Clone, Copy, Debug)]
pub struct GetUuids;
/// `mesh_msgs/GetGeometry`.
#[derive(Clone, Copy, Debug)]
pub struct GetGeometry;
/// `mesh_msgs/GetMaterials`.
#[derive(Clone, Copy, Debug)]
pub struct GetMaterials;
/// `mesh_msgs/GetVertexColors`.
#[derive(Clone, Copy, Debug)]
pub struct GetVertexColors;
/// `mesh_msgs/GetTexture`.
#[derive(Clone, Copy, Debug)]
pub struct GetTexture;

impl Service for GetUuids {
    const TYPE_NAME: &'static str = "mesh_msgs/srv/GetUUIDs";
    type Request = GetUuidsRequest;
    type Response<'a> = GetUuidsResponse;
}
impl Service for GetGeometry {
    const TYPE_NAME: &'static str = "mesh_msgs/srv/GetGeometry";
    type Request = GetGeometryRequest;
    type Response<'a> = GetGeometryResponse<'a>;
}
impl Service for GetMaterials {
    const TYPE_NAME: &'static str = "mesh_msgs/srv/GetMaterials";
    type Request = GetMaterialsRequest;
    type Response<'a> = GetMaterialsResponse<'a>;
}
impl Service for GetVertexColors {
    const TYPE_NAME: &'static str = "mesh_msgs/srv/GetVertexColors";
    type Request = GetVertexColorsRequest;
    type Response<'a> = GetVertexColorsResponse<'a>;
}
impl Service for GetTexture {
    const TYPE_NAME: &'static str = "mesh_msgs/srv/GetTexture";
    type Request = GetTextureRequest;
    type Response<'a> = GetTextureResponse<'a>;
}
