//! View buffers drawn by a GPU: the twin of [`crate::render::raster`].
//!
//! Input, output and conventions are the CPU's. Vertices are projected on the CPU in f64, snapped
//! to 1/256 px, and triangles that reach past the near plane or the guard band are clipped there by
//! the same code; both together are a few per cent of the CPU's work, and f32 would move corners
//! of a large mesh by whole pixels. The device then decides coverage and nearness with its
//! fixed-function rasteriser, and one pass over the pixels interpolates 1/z of the triangle it
//! kept, with edge functions exact in 64 bits. Ids and depths are thus the CPU's wherever both
//! keep the same triangle, up to the rounding of f32.
//!
//! They may keep different triangles where a pixel's centre lies within a hair of an edge (Vulkan
//! leaves open who owns it, and how fine the device's grid is: 1/256 px on most, 1/16 px is
//! allowed), and where two surfaces are nearer to each other than the device's depth resolves
//! (about 1e-6 of their depth). Triangles of the very same corners tie, and the lowest id is kept.
//!
//! The mesh's triangles are uploaded once; a view uploads 16 bytes a vertex and reads back 8 bytes
//! a pixel. Buffers are kept from view to view.

use std::num::NonZeroU64;
use std::sync::Arc;

use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::TriMesh;
use crate::render::backend::GpuError;
use crate::render::part::MeshPart;
use crate::render::raster::{
    DROPPED_BY_ALL, Fate, NO_TRIANGLE, NOT_WHOLE_BY_ANY, Projector, ScreenVertex, ViewBuffer,
    clip_to_pieces,
};

use super::GpuDevice;

/// Columns and rows of one workgroup of `resolve`.
const GROUP_SIDE_PX: u32 = 8;
const SLOT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// A corner as the shader reads it: x, y, the bits of 1/z, the outcode or, of a piece's first
/// corner, the triangle's id.
type Corner = [i32; 4];
const CORNER_BYTES: u64 = size_of::<Corner>() as u64;

fn corner(vertex: ScreenVertex) -> Corner {
    [
        vertex.x,
        vertex.y,
        vertex.inv_z.to_bits().cast_signed(),
        i32::from(vertex.outcode),
    ]
}

/// The shaders on a device. Clones share them.
#[derive(Clone, Debug)]
pub(in crate::render) struct GpuRasterizer {
    device: GpuDevice,
    pipelines: Arc<Pipelines>,
}

#[derive(Debug)]
struct Pipelines {
    input_layout: wgpu::BindGroupLayout,
    output_layout: wgpu::BindGroupLayout,
    cover: wgpu::RenderPipeline,
    resolve: wgpu::ComputePipeline,
}

impl GpuRasterizer {
    pub(in crate::render) fn new(device: GpuDevice) -> Result<Self, GpuError> {
        let pipelines = Arc::new(Pipelines::new(&device.device));
        device.check()?;
        Ok(Self { device, pipelines })
    }

    pub(in crate::render) fn device(&self) -> &GpuDevice {
        &self.device
    }

    /// Uploads a mesh.
    pub(in crate::render) fn load(&self, mesh: &TriMesh) -> Result<GpuMesh, GpuError> {
        let gpu = &self.device;
        let indices: &[u8] = bytemuck::cast_slice(mesh.triangles());
        let num_vertices = mesh.num_vertices() as u64;
        gpu.check_size("mesh's triangles", indices.len() as u64)?;
        gpu.check_size("mesh's vertices", num_vertices * CORNER_BYTES)?;
        let [uniform, storage] = [wgpu::BufferUsages::UNIFORM, wgpu::BufferUsages::STORAGE]
            .map(|usage| usage | wgpu::BufferUsages::COPY_DST);
        let view = buffer(gpu, "view", 16, uniform);
        let triangles = buffer(gpu, "triangles", indices.len() as u64, storage);
        gpu.queue.write_buffer(&triangles, 0, indices);
        let vertices = buffer(gpu, "vertices", num_vertices * CORNER_BYTES, storage);
        let pieces = buffer(gpu, "pieces", 0, storage);
        let input = self
            .pipelines
            .bind_input(gpu, [&view, &triangles, &vertices, &pieces]);
        gpu.check()?;
        Ok(GpuMesh {
            rasterizer: self.clone(),
            view,
            triangles,
            vertices,
            pieces,
            input,
            target: None,
            on_screen: vec![],
            piece_corners: vec![],
        })
    }
}

impl Pipelines {
    fn new(device: &wgpu::Device) -> Self {
        use wgpu::ShaderStages;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("raster"),
            source: wgpu::ShaderSource::Wgsl(include_str!("raster.wgsl").into()),
        });
        let corners = ShaderStages::VERTEX | ShaderStages::COMPUTE;
        let read = wgpu::BufferBindingType::Storage { read_only: true };
        let write = wgpu::BufferBindingType::Storage { read_only: false };
        let input_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("raster input"),
            entries: &[
                bind(0, corners, buffer_binding(wgpu::BufferBindingType::Uniform)),
                bind(1, corners, buffer_binding(read)),
                bind(2, corners, buffer_binding(read)),
                bind(3, corners, buffer_binding(read)),
            ],
        });
        let slots = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Uint,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let output_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("raster output"),
            entries: &[
                bind(0, ShaderStages::COMPUTE, slots),
                bind(1, ShaderStages::COMPUTE, buffer_binding(write)),
                bind(2, ShaderStages::COMPUTE, buffer_binding(write)),
            ],
        });
        let layout = |groups: &[Option<&wgpu::BindGroupLayout>]| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("raster"),
                bind_group_layouts: groups,
                immediate_size: 0,
            })
        };
        let constants = [
            ("DROPPED_BY_ALL", f64::from(DROPPED_BY_ALL)),
            ("NOT_WHOLE_BY_ANY", f64::from(NOT_WHOLE_BY_ANY)),
        ];
        let options = wgpu::PipelineCompilationOptions {
            constants: &constants,
            ..Default::default()
        };
        let cover = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("cover"),
            layout: Some(&layout(&[Some(&input_layout)])),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("cover"),
                compilation_options: options.clone(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            // 1/z: the greater is the nearer, and of equals the first one drawn is kept.
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("mark"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(SLOT_FORMAT.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let resolve = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("resolve"),
            layout: Some(&layout(&[Some(&input_layout), Some(&output_layout)])),
            module: &module,
            entry_point: Some("resolve"),
            compilation_options: options,
            cache: None,
        });
        Self {
            input_layout,
            output_layout,
            cover,
            resolve,
        }
    }

    fn bind_input(&self, gpu: &GpuDevice, buffers: [&wgpu::Buffer; 4]) -> wgpu::BindGroup {
        bind_buffers(gpu, &self.input_layout, &buffers)
    }
}

fn bind(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BindingType,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty,
        count: None,
    }
}

fn buffer_binding(ty: wgpu::BufferBindingType) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty,
        has_dynamic_offset: false,
        min_binding_size: None::<NonZeroU64>,
    }
}

fn bind_buffers(
    gpu: &GpuDevice,
    layout: &wgpu::BindGroupLayout,
    buffers: &[&wgpu::Buffer],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(buffers)
        .map(|(binding, buffer)| wgpu::BindGroupEntry {
            binding,
            resource: buffer.as_entire_binding(),
        })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("raster"),
        layout,
        entries: &entries,
    })
}

/// A buffer of at least one element, as bindings may not be empty.
fn buffer(gpu: &GpuDevice, label: &str, num_bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: num_bytes.max(CORNER_BYTES),
        usage,
        mapped_at_creation: false,
    })
}

/// A mesh on a device, with the buffers of its views.
#[derive(Debug)]
pub(in crate::render) struct GpuMesh {
    rasterizer: GpuRasterizer,
    view: wgpu::Buffer,
    triangles: wgpu::Buffer,
    vertices: wgpu::Buffer,
    pieces: wgpu::Buffer,
    input: wgpu::BindGroup,
    target: Option<Target>,
    on_screen: Vec<Corner>,
    piece_corners: Vec<Corner>,
}

/// What the views of one image size are drawn into.
#[derive(Debug)]
struct Target {
    width: u32,
    height: u32,
    slots: wgpu::TextureView,
    depth: wgpu::TextureView,
    triangle: wgpu::Buffer,
    depth_m: wgpu::Buffer,
    /// Ids, then depths.
    read_back: wgpu::Buffer,
    output: wgpu::BindGroup,
}

impl Target {
    fn new(rasterizer: &GpuRasterizer, width: u32, height: u32) -> Result<Self, GpuError> {
        let gpu = &rasterizer.device;
        let limit = gpu.device.limits().max_texture_dimension_2d;
        if width.max(height) > limit {
            return Err(GpuError::TooLarge {
                what: "image side",
                size: u64::from(width.max(height)),
                limit: u64::from(limit),
                unit: "pixels",
                adapter: gpu.name.clone(),
            });
        }
        let num_bytes = 4 * u64::from(width) * u64::from(height);
        gpu.check_size("image", num_bytes)?;
        gpu.check_size("image's ids and depths", 2 * num_bytes)?;
        let texture = |label, format, usage| {
            let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        let slots = texture("slots", SLOT_FORMAT, wgpu::TextureUsages::TEXTURE_BINDING);
        let depth = texture("depth", DEPTH_FORMAT, wgpu::TextureUsages::empty());
        let made = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let triangle = buffer(gpu, "ids", num_bytes, made);
        let depth_m = buffer(gpu, "depths", num_bytes, made);
        let read = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let read_back = buffer(gpu, "read back", 2 * num_bytes, read);
        let output = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("raster output"),
            layout: &rasterizer.pipelines.output_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&slots),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: triangle.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: depth_m.as_entire_binding(),
                },
            ],
        });
        gpu.check()?;
        Ok(Self {
            width,
            height,
            slots,
            depth,
            triangle,
            depth_m,
            read_back,
            output,
        })
    }

    fn num_bytes(&self) -> u64 {
        4 * u64::from(self.width) * u64::from(self.height)
    }

    /// Waits for the device and copies what it made.
    fn read(&self, gpu: &GpuDevice, out: &mut ViewBuffer) -> Result<(), GpuError> {
        let num_bytes = self.num_bytes();
        let both = self.read_back.slice(..2 * num_bytes);
        let (send, receive) = std::sync::mpsc::channel();
        both.map_async(wgpu::MapMode::Read, move |mapped| {
            // The receiver waits below, or has left with an error of its own.
            drop(send.send(mapped));
        });
        gpu.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| gpu.driver_error(error))?;
        gpu.check()?;
        receive
            .recv()
            .map_err(|error| gpu.driver_error(error))?
            .map_err(|error| gpu.driver_error(error))?;
        out.clear(self.width, self.height);
        {
            let bytes = both
                .get_mapped_range()
                .map_err(|error| gpu.driver_error(error))?;
            let (ids, depths) = bytes.split_at(bytes.len() / 2);
            bytemuck::cast_slice_mut(&mut out.triangle).copy_from_slice(ids);
            bytemuck::cast_slice_mut(&mut out.depth_m).copy_from_slice(depths);
        }
        self.read_back.unmap();
        Ok(())
    }
}

impl GpuMesh {
    /// Draws a part of the mesh that it was loaded from.
    pub(in crate::render) fn rasterize(
        &mut self,
        mesh: &TriMesh,
        part: &MeshPart,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        out: &mut ViewBuffer,
    ) -> Result<(), GpuError> {
        let (width, height) = (camera.width(), camera.height());
        let target = match self.target.take() {
            Some(target) if (target.width, target.height) == (width, height) => target,
            _ => Target::new(&self.rasterizer, width, height)?,
        };
        self.project(mesh, part, &Projector::new(camera, camera_from_world));
        self.upload([width, height], mesh)?;
        self.submit(part, mesh, &target);
        let read = target.read(&self.rasterizer.device, out);
        self.target = Some(target);
        read
    }

    fn project(&mut self, mesh: &TriMesh, part: &MeshPart, projector: &Projector) {
        let vertices = &mut self.on_screen;
        part.map_vertices(mesh, vertices, |p| corner(projector.project(p)));
        self.piece_corners.clear();
        for (triangle, corners) in part.triangles(mesh) {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "outcodes are bytes"
            )]
            let outcodes = corners.map(|v| vertices[v as usize][3] as u8);
            if Fate::of(outcodes) != Fate::Clipped {
                continue;
            }
            let points = corners.map(|v| projector.homogeneous(&mesh.positions_m()[v as usize]));
            clip_to_pieces(points, |piece| {
                let mut piece = piece.map(corner);
                piece[0][3] = triangle.cast_signed();
                self.piece_corners.extend(piece);
            });
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has fewer than 2³² triangles"
    )]
    fn upload(&mut self, [width, height]: [u32; 2], mesh: &TriMesh) -> Result<(), GpuError> {
        let gpu = &self.rasterizer.device;
        let pieces: &[u8] = bytemuck::cast_slice(&self.piece_corners);
        let num_bytes = pieces.len() as u64;
        if num_bytes > self.pieces.size() {
            gpu.check_size("mesh's clipped triangles", num_bytes)?;
            // Half as much again, so that a moving camera seldom asks for more.
            let roomy = (num_bytes + num_bytes / 2).next_multiple_of(CORNER_BYTES);
            let size = roomy.min(gpu.max_binding_bytes).max(num_bytes);
            self.pieces = buffer(gpu, "pieces", size, self.pieces.usage());
            let buffers = [&self.view, &self.triangles, &self.vertices, &self.pieces];
            self.input = self.rasterizer.pipelines.bind_input(gpu, buffers);
        }
        let view = [width, height, mesh.num_triangles() as u32, 0];
        gpu.queue
            .write_buffer(&self.view, 0, bytemuck::cast_slice(&view));
        let vertices = bytemuck::cast_slice(&self.on_screen);
        gpu.queue.write_buffer(&self.vertices, 0, vertices);
        gpu.queue.write_buffer(&self.pieces, 0, pieces);
        Ok(())
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "corners that fit a device's buffer are fewer than 2³²"
    )]
    fn submit(&self, part: &MeshPart, mesh: &TriMesh, target: &Target) {
        let gpu = &self.rasterizer.device;
        let pipelines = &self.rasterizer.pipelines;
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("view"),
            });
        {
            let clear = |value| wgpu::Operations {
                load: wgpu::LoadOp::Clear(value),
                store: wgpu::StoreOp::Store,
            };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("cover"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &target.slots,
                    depth_slice: None,
                    resolve_target: None,
                    ops: clear(wgpu::Color {
                        r: f64::from(NO_TRIANGLE),
                        ..wgpu::Color::TRANSPARENT
                    }),
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &target.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_pipeline(&pipelines.cover);
            pass.set_bind_group(0, &self.input, &[]);
            // In ascending order: of equal depths the lowest id is kept.
            for run in part.triangle_runs() {
                pass.draw(3 * run.start..3 * run.end, 0..1);
            }
            let first = 3 * mesh.num_triangles() as u32;
            pass.draw(first..first + self.piece_corners.len() as u32, 0..1);
        }
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("resolve"),
                timestamp_writes: None,
            });
            pass.set_pipeline(&pipelines.resolve);
            pass.set_bind_group(0, &self.input, &[]);
            pass.set_bind_group(1, &target.output, &[]);
            let [columns, rows] = [target.width, target.height].map(|n| n.div_ceil(GROUP_SIDE_PX));
            pass.dispatch_workgroups(columns, rows, 1);
        }
        let num_bytes = target.num_bytes();
        encoder.copy_buffer_to_buffer(&target.triangle, 0, &target.read_back, 0, num_bytes);
        encoder.copy_buffer_to_buffer(&target.depth_m, 0, &target.read_back, num_bytes, num_bytes);
        gpu.queue.submit([encoder.finish()]);
    }
}

#[cfg(test)]
mod tests;
