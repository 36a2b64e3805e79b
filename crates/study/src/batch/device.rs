//! The GPU: found through Vulkan, its buffers, and the steps that run on it.
//!
//! Input: a network in words and samples. Output: their spikes. The only file that names `wgpu`.
//! Errors: no Vulkan driver or device; buffers above the device's limits, named with value and
//! limit; what the driver reports.

use std::future::Future;
use std::marker::PhantomData;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use wgpu::util::DeviceExt;

use super::form::{Arithmetic, BatchForm, Trains, words};
use nsim_ir::spikes::Sample;

/// Invocations of a workgroup, as in the shaders.
const GROUP: u64 = 64;
/// Bytes of what a step is told.
const STEP_BYTES: u64 = 32;

const DECAYS: &str = concat!(include_str!("decay.wgsl"), include_str!("decays.wgsl"));

/// A device that computes.
#[derive(Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    limits: wgpu::Limits,
    /// Name of device and driver.
    name: String,
    /// Whether it is a processor that computes as one.
    software: bool,
}

/// Waits for what is ready soon: native futures of `wgpu` need nobody to wake them.
fn wait<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    loop {
        match future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(value) => return value,
            Poll::Pending => std::thread::yield_now(),
        }
    }
}

fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_ne_bytes()).collect()
}

impl Gpu {
    /// The first device that Vulkan offers: a card before the processor's own graphics, those
    /// before software.
    ///
    /// # Errors
    /// Why there is none.
    pub fn open() -> Result<Self, String> {
        let mut asked = wgpu::InstanceDescriptor::new_without_display_handle();
        asked.backends = wgpu::Backends::VULKAN;
        let instance = wgpu::Instance::new(asked);
        let rank = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::VirtualGpu => 1,
            wgpu::DeviceType::IntegratedGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        };
        let adapters = wait(instance.enumerate_adapters(wgpu::Backends::VULKAN));
        let none = "no GPU: Vulkan offers no device (a driver such as mesa-vulkan-drivers, and its loader, are needed)";
        let adapter = adapters.into_iter().min_by_key(rank).ok_or(none)?;
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let asked = wgpu::DeviceDescriptor { required_limits: limits.clone(), ..Default::default() };
        let name = format!("{} ({} {})", info.name, info.driver, info.driver_info);
        let (device, queue) = wait(adapter.request_device(&asked)).map_err(|error| format!("{name}: {error}"))?;
        Ok(Gpu { device, queue, limits, name, software: info.device_type == wgpu::DeviceType::Cpu })
    }

    /// Name of device and driver.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether a processor computes in place of a GPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.software
    }

    /// Runs something whose errors the device reports later.
    fn checked<T>(&self, run: impl FnOnce() -> T) -> Result<T, String> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let out = run();
        let found = [wait(validation.pop()), wait(memory.pop())];
        found.into_iter().flatten().next().map_or(Ok(out), |error| Err(format!("{}: {error}", self.name)))
    }

    /// Holds a buffer against the limits of the device.
    fn fits(&self, what: &str, bytes: u64) -> Result<(), String> {
        let limit = self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size);
        if bytes > limit {
            return Err(format!("{what} need {bytes} bytes, and {} holds {limit} in a buffer", self.name));
        }
        Ok(())
    }

    fn storage(&self, contents: &[u8]) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        // A buffer of nothing cannot be bound.
        let contents = if contents.is_empty() { &[0; 48] } else { contents };
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
    }

    fn pipeline(&self, source: &str, layout: Option<&wgpu::PipelineLayout>) -> wgpu::ComputePipeline {
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout,
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: None,
        })
    }

    /// Waits for all that was submitted and reads words back.
    fn read(&self, from: &wgpu::Buffer, words: usize) -> Result<Vec<u32>, String> {
        let size = 4 * words as u64;
        let to = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(from, 0, &to, 0, size);
        self.queue.submit([encoder.finish()]);
        let (send, receive) = std::sync::mpsc::channel();
        to.map_async(wgpu::MapMode::Read, .., move |mapped| drop(send.send(mapped)));
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| format!("{}: {error}", self.name))?;
        let mapped = receive.recv().map_err(|error| format!("{}: {error}", self.name))?;
        mapped.map_err(|error| format!("{}: {error}", self.name))?;
        let view = to.get_mapped_range(..).map_err(|error| format!("{}: {error}", self.name))?;
        let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte));
        Ok(view.chunks_exact(4).map(word).collect())
    }

    /// What the device's decay (equation 3) makes of values and what is kept of them in 4096ths: to
    /// be held against 64 bits.
    ///
    /// # Errors
    /// What the driver reports.
    pub fn decays(&self, pairs: &[(i32, i32)]) -> Result<Vec<i32>, String> {
        let list: Vec<u32> = pairs.iter().flat_map(|&(value, keep)| [value as u32, keep as u32]).collect();
        self.fits("values to decay", 4 * list.len() as u64)?;
        let results = self.checked(|| {
            let (from, to) = (self.storage(&bytes(&list)), self.storage(&vec![0; 4 * pairs.len()]));
            let pipeline = self.pipeline(DECAYS, None);
            let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &pipeline.get_bind_group_layout(0),
                entries: &[
                    wgpu::BindGroupEntry { binding: 0, resource: from.as_entire_binding() },
                    wgpu::BindGroupEntry { binding: 1, resource: to.as_entire_binding() },
                ],
            });
            let mut encoder = self.device.create_command_encoder(&Default::default());
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups((pairs.len() as u64).div_ceil(GROUP) as u32, 1, 1);
            drop(pass);
            self.queue.submit([encoder.finish()]);
            to
        })?;
        Ok(self.read(&results, pairs.len())?.into_iter().map(|word| word as i32).collect())
    }

    /// Room for so many samples of so many steps beside each other.
    ///
    /// # Errors
    /// What does not fit the device, with its size and the limit, or what the driver reports.
    pub fn batches<'a, A: Arithmetic>(
        &'a self,
        form: &'a BatchForm<A>,
        samples: u32,
        steps: u32,
    ) -> Result<Batches<'a, A>, String> {
        let (samples, steps) = (samples.max(1), steps.max(1));
        let invocations = u64::from(form.compartments()) * u64::from(samples);
        let (state_words, spike_words) =
            (A::STATE_WORDS * invocations, u64::from(steps) * u64::from(form.sources()) * words(samples) as u64);
        self.fits(&format!("{} compartments", form.compartments()), 4 * form.compartments.len() as u64)?;
        self.fits(&format!("{} synapses", form.synapses.len() / 3), 4 * form.synapses.len() as u64)?;
        self.fits(&format!("states of {samples} samples"), 4 * state_words)?;
        self.fits(&format!("spikes of {samples} samples of {steps} steps"), 4 * spike_words)?;
        let stride = STEP_BYTES.next_multiple_of(self.limits.min_uniform_buffer_offset_alignment.into());
        self.fits(&format!("numbers of {steps} steps"), stride * u64::from(steps))?;
        let groups = invocations.div_ceil(GROUP).max(1);
        let across = groups.min(self.limits.max_compute_workgroups_per_dimension.into());
        let (across, down) = (across as u32, groups.div_ceil(across) as u32);

        let mut told = vec![0u8; (stride * u64::from(steps)) as usize];
        for step in 0..steps {
            let (interval, offset) = form.reset.map_or((0, 0), |reset| (reset.interval, reset.offset));
            let numbers = [
                step,
                samples,
                words(samples) as u32,
                form.channels,
                form.sources(),
                form.compartments(),
                interval,
                offset,
            ];
            let at = (stride * u64::from(step)) as usize;
            told[at..at + STEP_BYTES as usize].copy_from_slice(&bytes(&numbers));
        }
        self.checked(|| {
            let buffer =
                |ty, has_dynamic_offset| wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None };
            let list = |read_only| buffer(wgpu::BufferBindingType::Storage { read_only }, false);
            let kinds =
                [buffer(wgpu::BufferBindingType::Uniform, true), list(true), list(true), list(false), list(false)];
            let entries: Vec<wgpu::BindGroupLayoutEntry> = (0..)
                .zip(kinds)
                .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                    binding,
                    visibility: wgpu::ShaderStages::COMPUTE,
                    ty,
                    count: None,
                })
                .collect();
            let group_layout = self
                .device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries });
            let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: None,
                bind_group_layouts: &[Some(&group_layout)],
                immediate_size: 0,
            });
            let pipeline = self.pipeline(A::SHADER, Some(&layout));
            let told = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: &told,
                usage: wgpu::BufferUsages::UNIFORM,
            });
            let empty = |words: u64| {
                self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size: 4 * words.max(1),
                    usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                })
            };
            let (states, spikes) = (empty(state_words), empty(spike_words));
            let (compartments, synapses) =
                (self.storage(&bytes(&form.compartments)), self.storage(&bytes(&form.synapses)));
            let step = wgpu::BufferBinding { buffer: &told, offset: 0, size: std::num::NonZeroU64::new(STEP_BYTES) };
            let lists = [&compartments, &synapses, &states, &spikes];
            let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(step) }];
            entries.extend(
                (1..)
                    .zip(lists)
                    .map(|(binding, list)| wgpu::BindGroupEntry { binding, resource: list.as_entire_binding() }),
            );
            let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &group_layout,
                entries: &entries,
            });
            Batches { gpu: self, form, samples, steps, stride, groups: (across, down), pipeline, group, states, spikes }
        })
    }
}

/// A network on a device, with room for a batch.
#[derive(Debug)]
pub struct Batches<'a, A> {
    gpu: &'a Gpu,
    form: &'a BatchForm<A>,
    samples: u32,
    steps: u32,
    /// Bytes from one step's numbers to the next's.
    stride: u64,
    /// Workgroups across and down.
    groups: (u32, u32),
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    states: wgpu::Buffer,
    spikes: wgpu::Buffer,
}

impl<A: Arithmetic> Batches<'_, A> {
    /// Runs samples from zero, to the end of the batch's window: input to the device, all steps,
    /// spikes back.
    ///
    /// # Errors
    /// More or longer samples than there is room for, or what the driver reports.
    pub fn run(&self, samples: &[&Sample]) -> Result<Trains<A>, String> {
        if samples.len() > self.samples as usize {
            return Err(format!("{} samples are more than the {} of the batch", samples.len(), self.samples));
        }
        let words = words(self.samples);
        let input = self.form.input(samples, self.steps, words)?;
        let gpu = self.gpu;
        gpu.checked(|| {
            gpu.queue.write_buffer(&self.spikes, 0, &bytes(&input));
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            encoder.clear_buffer(&self.states, 0, None);
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            for step in 0..self.steps {
                pass.set_bind_group(0, &self.group, &[(self.stride * u64::from(step)) as u32]);
                pass.dispatch_workgroups(self.groups.0, self.groups.1, 1);
            }
            drop(pass);
            gpu.queue.submit([encoder.finish()]);
        })?;
        let states = A::STATE_WORDS as usize * self.form.compartments() as usize * self.samples as usize;
        Ok(Trains {
            spikes: gpu.read(&self.spikes, input.len())?,
            states: gpu.read(&self.states, states)?,
            sources: self.form.sources() as usize,
            channels: self.form.channels as usize,
            samples: self.samples as usize,
            arithmetic: PhantomData,
        })
    }
}
