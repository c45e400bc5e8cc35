//! A GPU, reached through Vulkan by wgpu, and the view buffers that it draws.
//!
//! One [`GpuDevice`] serves a process: it is cloned freely, and what is built on it shares it.
//! Whatever a driver refuses becomes a [`GpuError`]; nothing here panics on a driver's word.

mod raster;

use std::sync::{Arc, Mutex, PoisonError};

use super::backend::GpuError;

pub(super) use raster::{GpuMesh, GpuRasterizer};

/// Which adapters may be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adapters {
    /// GPUs only.
    Hardware,
    /// GPUs first, then drivers that compute on the CPU, such as llvmpipe.
    WithSoftware,
}

/// An open device. Clones share it.
#[derive(Clone, Debug)]
pub struct GpuDevice {
    instance: wgpu::Instance,
    adapter: wgpu::Adapter,
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    is_software: bool,
    /// The largest buffer that a shader sees.
    max_binding_bytes: u64,
    /// What the driver complained of since it was last asked.
    complaint: Arc<Mutex<Option<String>>>,
}

impl GpuDevice {
    /// Opens the best adapter: discrete before integrated, virtual and unknown ones, software last.
    ///
    /// # Errors
    /// [`GpuError`] where there is no such adapter or it gives no device.
    pub fn open(adapters: Adapters) -> Result<Self, GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::VULKAN,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
        let num_found = found.len();
        found.retain(|a| {
            adapters == Adapters::WithSoftware || !is_software(a.get_info().device_type)
        });
        // The sort is stable: among equals the driver's order stands.
        found.sort_by_key(|adapter| preference(adapter.get_info().device_type));
        let Some(adapter) = found.into_iter().next() else {
            return Err(GpuError::NoAdapter {
                reason: if num_found == 0 {
                    "no Vulkan driver is installed, or it finds no device".to_owned()
                } else {
                    format!("{num_found} found, none of them a GPU")
                },
            });
        };
        let info = adapter.get_info();
        let name = format!("{} ({} {})", info.name, info.driver, info.driver_info);
        let unwanted =
            wgpu::Features::all_experimental_mask() | wgpu::Features::MAPPABLE_PRIMARY_BUFFERS;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("veneer"),
            required_features: adapter.features().difference(unwanted),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|error| GpuError::NoDevice {
            adapter: name.clone(),
            reason: error.to_string(),
        })?;
        let complaint = Arc::new(Mutex::new(None));
        let heard = Arc::clone(&complaint);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let mut heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
            heard.get_or_insert_with(|| error.to_string());
        }));
        let limits = device.limits();
        Ok(Self {
            max_binding_bytes: limits
                .max_storage_buffer_binding_size
                .min(limits.max_buffer_size),
            instance,
            adapter,
            device,
            queue,
            name,
            is_software: is_software(info.device_type),
            complaint,
        })
    }

    /// The adapter and its driver.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the driver computes on the CPU.
    pub fn is_software(&self) -> bool {
        self.is_software
    }

    /// What libraries that share the device ask for.
    pub fn handles(&self) -> (&wgpu::Instance, &wgpu::Adapter, &wgpu::Device, &wgpu::Queue) {
        (&self.instance, &self.adapter, &self.device, &self.queue)
    }

    /// Takes the device for a smaller one.
    #[cfg(test)]
    pub(super) fn limit_bindings(&mut self, max_binding_bytes: u64) {
        self.max_binding_bytes = max_binding_bytes;
    }

    /// Fails with what the driver complained of since the last call.
    ///
    /// # Errors
    /// [`GpuError::Driver`], once for each complaint.
    pub fn check(&self) -> Result<(), GpuError> {
        let complaint = self
            .complaint
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        complaint.map_or(Ok(()), |reason| Err(self.driver_error(reason)))
    }

    fn driver_error(&self, reason: impl std::fmt::Display) -> GpuError {
        GpuError::Driver {
            adapter: self.name.clone(),
            reason: reason.to_string(),
        }
    }

    /// Refuses a buffer that cannot be bound at once.
    fn check_size(&self, what: &'static str, num_bytes: u64) -> Result<(), GpuError> {
        if num_bytes > self.max_binding_bytes {
            return Err(GpuError::TooLarge {
                what,
                size: num_bytes,
                limit: self.max_binding_bytes,
                unit: "bytes",
                adapter: self.name.clone(),
            });
        }
        Ok(())
    }
}

fn is_software(device_type: wgpu::DeviceType) -> bool {
    device_type == wgpu::DeviceType::Cpu
}

fn preference(device_type: wgpu::DeviceType) -> u8 {
    match device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Any adapter, for tests that need one. `None`, said loudly, where there is none: the caller
    /// returns then.
    #[expect(clippy::print_stderr, reason = "a skipped test must be seen")]
    pub(crate) fn device() -> Option<GpuDevice> {
        match GpuDevice::open(Adapters::WithSoftware) {
            Ok(device) => {
                eprintln!("on {}", device.name());
                Some(device)
            }
            Err(reason) => {
                eprintln!("SKIPPED: {reason}");
                None
            }
        }
    }

    #[test]
    fn software_is_the_last_choice_and_none_for_those_who_want_hardware() {
        use wgpu::DeviceType::{Cpu, DiscreteGpu, IntegratedGpu, Other, VirtualGpu};
        let order = [DiscreteGpu, IntegratedGpu, VirtualGpu, Other, Cpu];
        assert!(order.is_sorted_by_key(|kind| preference(*kind)));
        let Some(any) = device() else { return };
        match GpuDevice::open(Adapters::Hardware) {
            Ok(hardware) => assert!(!hardware.is_software() && !any.is_software()),
            Err(reason) => {
                assert!(any.is_software());
                assert!(matches!(reason, GpuError::NoAdapter { .. }), "{reason}");
            }
        }
    }

    #[test]
    fn what_the_driver_refuses_becomes_an_error_once() {
        let Some(gpu) = device() else { return };
        drop(gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("absurd"),
            size: u64::MAX / 2,
            usage: wgpu::BufferUsages::STORAGE,
            mapped_at_creation: false,
        }));
        assert!(matches!(gpu.check(), Err(GpuError::Driver { .. })));
        assert_eq!(gpu.check(), Ok(()));
    }
}
