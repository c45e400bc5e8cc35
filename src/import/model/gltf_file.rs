//! glTF 2.0, as `.glb` or `.gltf`: triangles with `baseColorTexture`, else `COLOR_0`, times
//! `baseColorFactor`. The default scene's nodes are put where their transforms say; y up becomes z
//! up. Buffers and images may be inside, as data URIs, or files beside it. Sparse accessors,
//! triangle strips and compressed meshes are refused.

use std::sync::Arc;

use base64::Engine;
use gltf::accessor::{DataType, Dimensions};
use gltf::texture::WrappingMode;
use nalgebra::{Matrix4, Point3, Vector4};

use super::{ModelFile, ModelFileError};
use crate::geom::ColorImage;
use crate::geom::color::srgb_from_linear;
use crate::mesh::{Material, ModelParts, Wrap};

/// Deeper trees of nodes than any program writes are refused before the stack ends.
const MAX_DEPTH: usize = 256;

pub(super) fn read(file: &ModelFile<'_>) -> Result<ModelParts, ModelFileError> {
    let bytes = file.bytes()?;
    let unreadable = |error| file.refuse(format!("not a readable glTF file: {error}"));
    let gltf::Gltf { document, blob } =
        gltf::Gltf::from_slice_without_validation(&bytes).map_err(unreadable)?;
    let root = document.into_json();
    check_attributes(&root).map_err(|reason| file.refuse(reason))?;
    let document = gltf::Document::from_json(root).map_err(unreadable)?;
    let mut reader = Reader {
        file,
        buffers: Vec::new(),
        images: Vec::new(),
        parts: ModelParts::default(),
        is_colored: false,
        is_visited: vec![false; document.nodes().count()],
    };
    reader.read_buffers(&document, blob)?;
    for image in document.images() {
        let image = reader.read_image(&image)?;
        reader.images.push(image);
    }
    for material in document.materials() {
        let material = reader.convert(&material);
        reader.parts.materials.push(material);
    }
    // For primitives without one.
    reader.parts.materials.push(Material::default());

    let scene = document
        .default_scene()
        .or_else(|| document.scenes().next())
        .ok_or_else(|| file.refuse("it has no scene"))?;
    for node in scene.nodes() {
        reader.push_node(&node, &z_up_from_y_up(), 0)?;
    }
    if !reader.is_colored {
        reader.parts.vertex_srgb.clear();
    }
    Ok(reader.parts)
}

/// Checks that the attributes of primitives are there: validating looks at them before it knows.
fn check_attributes(root: &gltf::json::Root) -> Result<(), String> {
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    for accessor in primitives.flat_map(|primitive| primitive.attributes.values()) {
        let (index, num) = (accessor.value(), root.accessors.len());
        if index >= num {
            return Err(format!("a primitive asks for accessor {index} of {num}"));
        }
    }
    Ok(())
}

/// (x, y, z) of glTF becomes (x, −z, y).
fn z_up_from_y_up() -> Matrix4<f64> {
    Matrix4::new(
        1.0, 0.0, 0.0, 0.0, //
        0.0, 0.0, -1.0, 0.0, //
        0.0, 1.0, 0.0, 0.0, //
        0.0, 0.0, 0.0, 1.0,
    )
}

struct Reader<'a> {
    file: &'a ModelFile<'a>,
    buffers: Vec<Vec<u8>>,
    images: Vec<Arc<ColorImage>>,
    parts: ModelParts,
    is_colored: bool,
    /// Nodes that were placed already: a tree comes by each once.
    is_visited: Vec<bool>,
}

impl Reader<'_> {
    fn read_buffers(
        &mut self,
        document: &gltf::Document,
        mut blob: Option<Vec<u8>>,
    ) -> Result<(), ModelFileError> {
        for buffer in document.buffers() {
            let bytes = match buffer.source() {
                gltf::buffer::Source::Bin => blob
                    .take()
                    .ok_or_else(|| self.file.refuse("its binary chunk is missing"))?,
                gltf::buffer::Source::Uri(uri) => self.uri_bytes(uri)?,
            };
            self.buffers.push(bytes);
        }
        Ok(())
    }

    fn uri_bytes(&self, uri: &str) -> Result<Vec<u8>, ModelFileError> {
        let Some(data) = uri.strip_prefix("data:") else {
            return self.file.beside(&percent_decoded(uri));
        };
        let (_, encoded) = data
            .split_once(";base64,")
            .ok_or_else(|| self.file.refuse("a data URI is not base64"))?;
        base64::engine::general_purpose::STANDARD
            .decode(encoded)
            .map_err(|error| self.file.refuse(format!("a data URI: {error}")))
    }

    fn read_image(&self, image: &gltf::Image<'_>) -> Result<Arc<ColorImage>, ModelFileError> {
        let name = image
            .name()
            .map_or_else(|| format!("image {}", image.index()), str::to_owned);
        match image.source() {
            gltf::image::Source::Uri { uri, .. } => self.file.image(&name, self.uri_bytes(uri)?),
            gltf::image::Source::View { view, .. } => {
                self.file.image(&name, self.view_bytes(&view)?.to_vec())
            }
        }
    }

    fn convert(&self, material: &gltf::Material<'_>) -> Material {
        let surface = material.pbr_metallic_roughness();
        let [r, g, b, _] = surface.base_color_factor();
        let mut converted = Material {
            factor: [r, g, b],
            ..Material::default()
        };
        if let Some(texture) = surface.base_color_texture().map(|info| info.texture()) {
            let wrap = |mode| match mode {
                WrappingMode::ClampToEdge => Wrap::Clamp,
                WrappingMode::MirroredRepeat => Wrap::Mirror,
                WrappingMode::Repeat => Wrap::Repeat,
            };
            let sampler = texture.sampler();
            converted.image = self.images.get(texture.source().index()).cloned();
            converted.wrap = [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())];
        }
        converted
    }

    fn push_node(
        &mut self,
        node: &gltf::Node<'_>,
        parent: &Matrix4<f64>,
        depth: usize,
    ) -> Result<(), ModelFileError> {
        let is_again = self
            .is_visited
            .get_mut(node.index())
            .is_none_or(|is_visited| std::mem::replace(is_visited, true));
        if is_again || depth > MAX_DEPTH {
            return Err(self.file.refuse("its nodes are no tree, or too deep a one"));
        }
        let columns = node.transform().matrix();
        let local = Matrix4::from_fn(|row, column| f64::from(columns[column][row]));
        let world = parent * local;
        if let Some(mesh) = node.mesh() {
            for primitive in mesh.primitives() {
                self.push_primitive(&primitive, &world)?;
            }
        }
        for child in node.children() {
            self.push_node(&child, &world, depth + 1)?;
        }
        Ok(())
    }

    fn push_primitive(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        world: &Matrix4<f64>,
    ) -> Result<(), ModelFileError> {
        match primitive.mode() {
            gltf::mesh::Mode::Triangles => {}
            gltf::mesh::Mode::TriangleStrip | gltf::mesh::Mode::TriangleFan => {
                return Err(self.file.refuse("triangle strips and fans are not read"));
            }
            _ => return Ok(()),
        }
        let positions = primitive
            .get(&gltf::Semantic::Positions)
            .ok_or_else(|| self.file.refuse("a primitive has no positions"))?;
        let positions = self.floats::<3>(&positions)?;
        let num_vertices = positions.len();
        let material = primitive.material();
        let uv_set = material
            .pbr_metallic_roughness()
            .base_color_texture()
            .map_or(0, |info| info.tex_coord());
        let uv = match primitive.get(&gltf::Semantic::TexCoords(uv_set)) {
            Some(accessor) => self.floats::<2>(&accessor)?,
            None => vec![[f32::NAN; 2]; num_vertices],
        };
        let colors = match primitive.get(&gltf::Semantic::Colors(0)) {
            Some(accessor) => {
                self.is_colored = true;
                self.colors(&accessor)?
            }
            None => vec![[255; 3]; num_vertices],
        };
        if uv.len() != num_vertices || colors.len() != num_vertices {
            return Err(self
                .file
                .refuse("a primitive's attributes differ in number"));
        }
        let indices = match primitive.indices() {
            Some(accessor) => self.indices(&accessor)?,
            None => (0..num_vertices).collect(),
        };

        let first = self.parts.positions_m.len();
        let number = material.index().unwrap_or(self.parts.materials.len() - 1);
        let number = u32::try_from(number).map_err(|_| self.file.refuse("too many materials"))?;
        for corners in indices.chunks_exact(3) {
            let mut triangle = [0u32; 3];
            let mut corners_uv = [[0.0; 2]; 3];
            for (i, &corner) in corners.iter().enumerate() {
                corners_uv[i] = *uv.get(corner).ok_or_else(|| {
                    self.file
                        .refuse(format!("a triangle has vertex {corner} of {num_vertices}"))
                })?;
                triangle[i] = u32::try_from(first + corner)
                    .map_err(|_| self.file.refuse("too many vertices"))?;
            }
            self.parts.triangles.push(triangle);
            self.parts.corners_uv.push(corners_uv);
            self.parts.materials_of_triangles.push(number);
        }
        self.parts.positions_m.extend(positions.iter().map(|p| {
            let [x, y, z] = p.map(f64::from);
            let moved = world * Vector4::new(x, y, z, 1.0);
            Point3::new(moved.x, moved.y, moved.z)
        }));
        self.parts.vertex_srgb.extend(colors);
        Ok(())
    }

    fn view_bytes(&self, view: &gltf::buffer::View<'_>) -> Result<&[u8], ModelFileError> {
        view.offset()
            .checked_add(view.length())
            .and_then(|end| {
                let buffer = self.buffers.get(view.buffer().index())?;
                buffer.get(view.offset()..end)
            })
            .ok_or_else(|| self.file.refuse("a part of it lies outside its buffer"))
    }

    /// The components of every element, one after the other, as numbers; normalised ones in
    /// [0, 1].
    fn components(
        &self,
        accessor: &gltf::Accessor<'_>,
    ) -> Result<(usize, Vec<f64>), ModelFileError> {
        if accessor.sparse().is_some() {
            return Err(self.file.refuse("sparse accessors are not read"));
        }
        let view = accessor
            .view()
            .ok_or_else(|| self.file.refuse("an accessor has no data"))?;
        let bytes = self.view_bytes(&view)?;
        let num_components = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec2 => 2,
            Dimensions::Vec3 => 3,
            Dimensions::Vec4 => 4,
            _ => return Err(self.file.refuse("an accessor holds matrices")),
        };
        let (size, scale) = match accessor.data_type() {
            DataType::U8 => (1, 255.0),
            DataType::I8 => (1, 127.0),
            DataType::U16 => (2, 65_535.0),
            DataType::I16 => (2, 32_767.0),
            DataType::U32 => (4, 4_294_967_295.0),
            DataType::F32 => (4, 1.0),
        };
        let scale = if accessor.normalized() { scale } else { 1.0 };
        let stride = view.stride().unwrap_or(num_components * size);
        let outside = || self.file.refuse("an accessor reaches past its data");
        let element_bytes = num_components * size;
        if stride < element_bytes {
            return Err(self.file.refuse("an accessor's stride is too small"));
        }
        let bytes = bytes.get(accessor.offset()..).ok_or_else(outside)?;
        let count = accessor.count();
        // Checked before anything is allocated: a claimed count costs nothing.
        let needed = count.checked_sub(1).map_or(Some(0), |last| {
            last.checked_mul(stride)?.checked_add(element_bytes)
        });
        if needed.is_none_or(|needed| needed > bytes.len()) {
            return Err(outside());
        }
        let mut values = Vec::with_capacity(count * num_components);
        for element in 0..count {
            for component in 0..num_components {
                let at = element * stride + component * size;
                let raw = bytes.get(at..at + size).ok_or_else(outside)?;
                let value = match (accessor.data_type(), raw) {
                    (DataType::U8, [a]) => f64::from(*a),
                    (DataType::I8, [a]) => f64::from(a.cast_signed()),
                    (DataType::U16, [a, b]) => f64::from(u16::from_le_bytes([*a, *b])),
                    (DataType::I16, [a, b]) => f64::from(i16::from_le_bytes([*a, *b])),
                    (DataType::U32, [a, b, c, d]) => {
                        f64::from(u32::from_le_bytes([*a, *b, *c, *d]))
                    }
                    (DataType::F32, [a, b, c, d]) => {
                        f64::from(f32::from_le_bytes([*a, *b, *c, *d]))
                    }
                    _ => return Err(outside()),
                };
                values.push(value / scale);
            }
        }
        Ok((num_components, values))
    }

    fn floats<const N: usize>(
        &self,
        accessor: &gltf::Accessor<'_>,
    ) -> Result<Vec<[f32; N]>, ModelFileError> {
        let (num_components, values) = self.components(accessor)?;
        if num_components != N {
            return Err(self.file.refuse(format!(
                "an attribute has {num_components} components, not {N}"
            )));
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let element = |element: &[f64]| std::array::from_fn(|i| element[i] as f32);
        Ok(values.chunks_exact(N).map(element).collect())
    }

    /// Linear in the file, sRGB here.
    fn colors(&self, accessor: &gltf::Accessor<'_>) -> Result<Vec<[u8; 3]>, ModelFileError> {
        let (num_components, values) = self.components(accessor)?;
        if num_components < 3 {
            return Err(self.file.refuse("a colour has fewer than three components"));
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let byte = |value: f64| srgb_from_linear(value as f32);
        let color = |c: &[f64]| [byte(c[0]), byte(c[1]), byte(c[2])];
        Ok(values.chunks_exact(num_components).map(color).collect())
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "only unsigned whole numbers come here"
    )]
    fn indices(&self, accessor: &gltf::Accessor<'_>) -> Result<Vec<usize>, ModelFileError> {
        let is_whole = matches!(
            accessor.data_type(),
            DataType::U8 | DataType::U16 | DataType::U32
        );
        let (num_components, values) = self.components(accessor)?;
        if num_components != 1 || !is_whole || accessor.normalized() {
            return Err(self.file.refuse("its indices are not whole numbers"));
        }
        Ok(values.into_iter().map(|value| value as usize).collect())
    }
}

/// `%20` and its kin in the names of files.
fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        let hex = tail
            .get(..2)
            .filter(|_| first == b'%')
            .and_then(|digits| std::str::from_utf8(digits).ok())
            .and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(hex.unwrap_or(first));
        rest = if hex.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
