//! View buffers on the CPU or on a GPU, behind one interface.
//!
//! The GPU's buffers are the CPU's ([`super::raster`]) but for pixels at edges, where two
//! rasterisers may round differently: see `render::gpu::raster`. The choice is made once, in
//! [`ViewRasterizer::new`]; [`Backend::Auto`] says in the log what it took and why, and
//! [`ViewRasterizer::device_name`] names it.

use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::TriMesh;

use super::part::MeshRuns;
use super::raster::{RasterWorkspace, ViewBuffer, rasterize_part};

#[cfg(feature = "gpu")]
use super::gpu::{Adapters, GpuDevice, GpuMesh, GpuRasterizer};

/// Where work is done that a GPU can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Backend {
    /// On the CPU; the same bits every time.
    #[default]
    Cpu,
    /// On a GPU, or on a driver that acts as one; an error where there is neither.
    Gpu,
    /// On a GPU where there is a real one, else on the CPU.
    Auto,
}

/// Why a GPU did not do the work.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// The code is not in this build.
    #[error("this build has no GPU code; build with `--features gpu`, or choose the CPU")]
    NotBuilt,
    /// There is none that may be taken.
    #[error("no Vulkan adapter can be used: {reason}")]
    NoAdapter {
        /// What was looked for in vain.
        reason: String,
    },
    /// There is one, but it could not be opened.
    #[error("{adapter} gave no device: {reason}")]
    NoDevice {
        /// Which adapter.
        adapter: String,
        /// The driver's words.
        reason: String,
    },
    /// A mesh or an image is beyond what the device can take at once.
    #[error("{what} of {size} {unit}; {adapter} takes at most {limit}")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// How large it is.
        size: u64,
        /// What the device takes.
        limit: u64,
        /// Of what.
        unit: &'static str,
        /// Which adapter.
        adapter: String,
    },
    /// The driver failed.
    #[error("{adapter} failed: {reason}")]
    Driver {
        /// Which adapter.
        adapter: String,
        /// The driver's words.
        reason: String,
    },
}

/// Draws view buffers where it was told to. Meshes are handed to it one by one, by
/// [`Self::load`].
#[derive(Clone, Debug)]
pub struct ViewRasterizer {
    backend: Backend,
    device_name: String,
    #[cfg(feature = "gpu")]
    gpu: Option<GpuRasterizer>,
}

impl ViewRasterizer {
    /// Opens the device.
    ///
    /// # Errors
    /// [`GpuError`] where [`Backend::Gpu`] was asked for and there is none.
    pub fn new(backend: Backend) -> Result<Self, GpuError> {
        match backend {
            Backend::Cpu => Ok(Self::on_cpu(backend)),
            Backend::Gpu => Self::on_gpu(backend),
            Backend::Auto => Ok(Self::on_gpu(backend).unwrap_or_else(|reason| {
                tracing::info!(%reason, "views are drawn on the CPU");
                Self::on_cpu(backend)
            })),
        }
    }

    /// What was asked for.
    pub fn backend(&self) -> Backend {
        self.backend
    }

    /// What draws: `CPU`, or the adapter and its driver.
    pub fn device_name(&self) -> &str {
        &self.device_name
    }

    /// The device, for others to share; none on the CPU.
    #[cfg(feature = "gpu")]
    pub fn device(&self) -> Option<&GpuDevice> {
        self.gpu.as_ref().map(GpuRasterizer::device)
    }

    fn on_cpu(backend: Backend) -> Self {
        Self {
            backend,
            device_name: "CPU".to_owned(),
            #[cfg(feature = "gpu")]
            gpu: None,
        }
    }

    #[cfg(not(feature = "gpu"))]
    fn on_gpu(_: Backend) -> Result<Self, GpuError> {
        Err(GpuError::NotBuilt)
    }

    #[cfg(feature = "gpu")]
    fn on_gpu(backend: Backend) -> Result<Self, GpuError> {
        let gpu = GpuRasterizer::new(GpuDevice::open(match backend {
            Backend::Gpu => Adapters::WithSoftware,
            Backend::Cpu | Backend::Auto => Adapters::Hardware,
        })?)?;
        let device_name = gpu.device().name().to_owned();
        tracing::info!(adapter = device_name, "views are drawn on the GPU");
        Ok(Self {
            backend,
            device_name,
            gpu: Some(gpu),
        })
    }

    /// Readies a mesh for any number of views.
    ///
    /// # Errors
    /// [`GpuError`] where [`Backend::Gpu`] was asked for and the device cannot take the mesh.
    pub fn load<'m>(&self, mesh: &'m TriMesh) -> Result<MeshViews<'m>, GpuError> {
        Ok(MeshViews {
            mesh,
            runs: MeshRuns::new(mesh),
            workspace: RasterWorkspace::default(),
            #[cfg(feature = "gpu")]
            may_fall_back: self.backend != Backend::Gpu,
            #[cfg(feature = "gpu")]
            gpu: match self.gpu.as_ref().map(|gpu| gpu.load(mesh)).transpose() {
                Err(reason) if self.backend != Backend::Gpu => {
                    tracing::warn!(%reason, "views of this mesh are drawn on the CPU");
                    None
                }
                loaded => loaded?,
            },
        })
    }
}

/// A mesh, ready to be drawn.
#[derive(Debug)]
pub struct MeshViews<'m> {
    mesh: &'m TriMesh,
    runs: MeshRuns,
    workspace: RasterWorkspace,
    #[cfg(feature = "gpu")]
    may_fall_back: bool,
    #[cfg(feature = "gpu")]
    gpu: Option<GpuMesh>,
}

impl MeshViews<'_> {
    /// The mesh.
    pub fn mesh(&self) -> &TriMesh {
        self.mesh
    }

    /// Draws what a camera sees of the mesh into `out`, which takes the camera's size.
    ///
    /// # Errors
    /// [`GpuError`] where [`Backend::Gpu`] was asked for and the image is too large for the device,
    /// or the driver fails; with [`Backend::Auto`] the CPU draws then, and the log says so.
    pub fn rasterize(
        &mut self,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        out: &mut ViewBuffer,
    ) -> Result<(), GpuError> {
        let part = self.runs.in_view(camera, camera_from_world, f64::INFINITY);
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &mut self.gpu {
            match gpu.rasterize(self.mesh, &part, camera, camera_from_world, out) {
                Ok(()) => return Ok(()),
                Err(reason) if self.may_fall_back => {
                    tracing::warn!(%reason, "this view is drawn on the CPU");
                    if matches!(reason, GpuError::Driver { .. }) {
                        self.gpu = None;
                    }
                }
                Err(reason) => return Err(reason),
            }
        }
        let workspace = &mut self.workspace;
        rasterize_part(self.mesh, &part, camera, camera_from_world, workspace, out);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn triangle() -> TriMesh {
        let corners = [[-1.0, -1.0, 2.0], [1.0, -1.0, 2.0], [0.0, 1.0, 3.0]];
        TriMesh::from_soup(corners.map(Point3::from).to_vec(), vec![[0, 1, 2]])
            .unwrap()
            .0
    }

    #[test]
    fn the_cpu_is_named_and_draws_what_the_raster_draws() {
        let rasterizer = ViewRasterizer::new(Backend::Cpu).unwrap();
        assert_eq!(rasterizer.device_name(), "CPU");
        let mesh = triangle();
        let camera = PinholeCamera::new([60.0, 60.0, 31.5, 23.5], 64, 48).unwrap();
        let pose = RigidTransform::identity();
        let [mut view, mut expected] = [ViewBuffer::default(), ViewBuffer::default()];
        let mut views = rasterizer.load(&mesh).unwrap();
        views.rasterize(&camera, &pose, &mut view).unwrap();
        let workspace = &mut RasterWorkspace::default();
        super::super::rasterize(&mesh, &camera, &pose, workspace, &mut expected);
        assert!(expected.triangle.contains(&0));
        assert_eq!(view, expected);
    }

    #[cfg(not(feature = "gpu"))]
    #[test]
    fn a_build_without_gpu_code_says_so_and_auto_takes_the_cpu() {
        let refused = ViewRasterizer::new(Backend::Gpu).unwrap_err();
        assert_eq!(refused, GpuError::NotBuilt);
        assert_eq!(
            ViewRasterizer::new(Backend::Auto).unwrap().device_name(),
            "CPU"
        );
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn auto_takes_no_software_driver() {
        let rasterizer = ViewRasterizer::new(Backend::Auto).unwrap();
        assert!(rasterizer.device().is_none_or(|d| !d.is_software()));
        assert_eq!(
            rasterizer.device().is_none(),
            rasterizer.device_name() == "CPU"
        );
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn auto_draws_on_the_cpu_what_the_device_cannot_take_and_gpu_refuses_it() {
        let Some(mut device) = super::super::gpu::tests::device() else {
            return;
        };
        let mesh = triangle();
        let small = PinholeCamera::new([60.0, 60.0, 31.5, 23.5], 64, 48).unwrap();
        let large = small.resized(640, 480).unwrap();
        device.limit_bindings(4 * 64 * 48 * 2);
        let name = device.name().to_owned();
        let gpu = GpuRasterizer::new(device).unwrap();
        for backend in [Backend::Auto, Backend::Gpu] {
            let rasterizer = ViewRasterizer {
                backend,
                device_name: name.clone(),
                gpu: Some(gpu.clone()),
            };
            let mut views = rasterizer.load(&mesh).unwrap();
            let mut view = ViewBuffer::default();
            let pose = RigidTransform::identity();
            views.rasterize(&small, &pose, &mut view).unwrap();
            assert!(view.triangle.contains(&0));
            let drawn = views.rasterize(&large, &pose, &mut view);
            if backend == Backend::Gpu {
                assert!(matches!(drawn, Err(GpuError::TooLarge { .. })), "{drawn:?}");
                continue;
            }
            drawn.unwrap();
            assert_eq!((view.width, view.height), (640, 480));
            assert!(view.triangle.contains(&0));
            views.rasterize(&small, &pose, &mut view).unwrap();
            assert!(
                views.gpu.is_some(),
                "one large view is no reason to leave the GPU"
            );
        }
    }
}
