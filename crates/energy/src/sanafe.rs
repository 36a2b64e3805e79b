//! Exports a mapped program and a sample to files of SANA-FE 2.2, to compare its energy and time
//! with nsim's.
//!
//! Input: a compiled network, constants, one sample. Output: an architecture and a network with its
//! mapping, in YAML. Energies and times are written as whole femtojoules and picoseconds, so both
//! programs charge equal amounts.
//!
//! Mapping of terms: a core is a core of the same tile, with tiles counted column by column.
//! Compartments are `leaky_integrate_fire` in 64ths of the chip's voltage. SANA-FE truncates it to
//! a 64th as the chip does, so voltages agree bit for bit. Its current is not truncated, so spikes
//! agree for certain only if `du` is 4096. Input channels are `input` neurons on one more core at
//! the corner of their chip, where only the route through the mesh is charged. SANA-FE delivers a
//! step after sending. Inputs of step t without delay are therefore sent in step t - 1, after a
//! leading step if step 0 has any. Inputs of delay 1 are sent in their own step.
//!
//! Not exported: the work of x86 cores (a separate phase in nsim), static power, and limits of the
//! voltage. Features that the format lacks are refused: other delays, periodic resets, delayed
//! starts, `threshold: Inclusive`.

use std::collections::BTreeMap;
use std::fmt::Write;

use nsim_compile::Mapping;
use nsim_cost::CostTable;
use nsim_dynamics::RealForm;
use nsim_dynamics::arithmetic::scaled;
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::base::units::{Femtojoules, Picoseconds};
use nsim_ir::program::{AxonTarget, Compartment, CoreClass, Program};
use nsim_ir::spikes::Sample;

/// Input of an export.
#[derive(Debug, Clone, Copy)]
pub struct Export<'a> {
    /// The mapped network.
    pub compiled: &'a Mapping,
    /// Its constants.
    pub table: &'a CostTable,
    /// The input sample.
    pub sample: &'a Sample,
    /// Number of tiles in the barrier.
    pub tiles_used: u64,
}

fn refused(what: impl Into<String>) -> Diagnostic {
    Diagnostic::new("export.sanafe", format!("SANA-FE's files do not support {}", what.into()))
}

fn seconds(time: Picoseconds) -> String {
    format!("{}.0e-12", time.0)
}

/// Attributes with the energy and latency of an event.
fn costs(of: &str, (energy, time): (Femtojoules, Picoseconds)) -> String {
    format!("energy_{of}: {}.0e-15, latency_{of}: {}", energy.0, seconds(time))
}

/// Attributes of a neuron.
fn attributes(compartment: &Compartment, semantics: Semantics, synapse: &str) -> String {
    let neuron = RealForm::of_neuron(&compartment.neuron, semantics);
    let bias = neuron.bias / 64.0;
    let mut out = format!(
        "[threshold: {:?}, reset: 0.0, reset_mode: {}, leak_decay: {:?}, input_decay: {:?}, synapse_hw_name: {synapse}",
        neuron.threshold / 64.0,
        if neuron.subtracts { "soft" } else { "hard" },
        neuron.keep_v,
        neuron.keep_u,
    );
    if bias != 0.0 {
        let _ = write!(out, ", bias: {bias:?}");
    }
    if neuron.refractory > 1 {
        let _ = write!(out, ", refractory_delay: {}", neuron.refractory - 1);
    }
    out + "]"
}

/// Dense and sparse synapses of each compartment of a core.
fn synapse_counts(class: &CoreClass) -> Vec<[u64; 2]> {
    let mut counts = vec![[0; 2]; class.compartments.len()];
    for synapse in class.inputs.synapses() {
        let sparse = class.formats[usize::from(synapse.format)].index_bits.is_some();
        counts[usize::from(synapse.slot)][usize::from(sparse)] += 1;
    }
    counts
}

/// Synapse unit of each compartment of a core: the unit of most of its synapses.
fn units(class: &CoreClass) -> Vec<&'static str> {
    fn unit([dense, sparse]: [u64; 2]) -> &'static str {
        if sparse > dense { "sparse" } else { "dense" }
    }
    synapse_counts(class).into_iter().map(unit).collect()
}

/// Compartments reached by lists of both kinds, whose synapses SANA-FE charges as one kind.
fn mixed(program: &Program) -> u64 {
    let counts = program.cores().ids().flat_map(|core| synapse_counts(program.class_of(core)));
    counts.filter(|[dense, sparse]| *dense > 0 && *sparse > 0).count() as u64
}

impl Export<'_> {
    fn program(&self) -> &Program {
        &self.compiled.program
    }

    /// Number of columns and rows of tiles that are written, up to the last in use.
    fn size(&self) -> (u32, u32) {
        let tiles = self.program().cores().iter().map(|image| self.program().mesh().tile(image.site));
        tiles.fold((1, 1), |(width, height), (x, y)| (width.max(x + 1), height.max(y + 1)))
    }

    /// A tile's number: column by column.
    fn tile(&self, (x, y): (u32, u32)) -> u32 {
        x * self.size().1 + y
    }

    /// The tile through which a core's inputs enter.
    fn corner(&self, core: CoreId) -> (u32, u32) {
        let mesh = self.program().mesh();
        let (x, y) = mesh.tile(self.program().cores()[core].site);
        (x - x % mesh.width, y - y % mesh.height)
    }

    /// For each corner in use, the channels that enter there.
    fn ports(&self) -> BTreeMap<(u32, u32), Vec<usize>> {
        let mut ports: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
        for (channel, messages) in self.program().parts().channels.iter().enumerate() {
            for message in messages {
                let channels = ports.entry(self.corner(message.core)).or_default();
                if channels.last() != Some(&channel) {
                    channels.push(channel);
                }
            }
        }
        ports
    }

    fn check(&self) -> Result<(), Diagnostic> {
        let parts = self.program().parts();
        if parts.threshold == ThresholdTest::Inclusive {
            return Err(refused("spikes of compartments that only reach their threshold (threshold: Inclusive)"));
        }
        if let Some(learning) = parts.learning.rules.iter().next() {
            return Err(refused(format!("the learning rule of projection '{}'", learning.name)));
        }
        if !parts.graded.is_empty() {
            return Err(refused("messages that carry integers"));
        }
        let mut compartments = self.program().classes().iter().flat_map(|class| &class.compartments);
        if let Some(compartment) = compartments.find(|compartment| !compartment.neuron.kind.table().registers) {
            return Err(refused(format!("{} neurons", compartment.neuron.kind.name())));
        }
        if parts.reset.is_some() {
            return Err(refused("resets within a sample"));
        }
        if self.delays(self.program().cores().iter().flat_map(|image| image.axons_out.items())) != (0, 0) {
            return Err(refused("delays between compartments as nsim counts them")
                .help("give all projections between compartments delay 0"));
        }
        let (least, most) = self.delays(parts.channels.items().iter().copied());
        if least != most || most > 1 {
            let message = "inputs with different delays, or delays above 1";
            return Err(refused(message).help("give all projections from inputs delay 0, or all delay 1"));
        }
        let leads = self.leads();
        for class in self.program().classes() {
            for compartment in &class.compartments {
                if !compartment.neuron.stack.is_unused() {
                    return Err(refused("neurons of several compartments"));
                }
                if compartment.start_step > 0 {
                    let help = "layers without input before their start do not need it: --set \
                                populations.NAME.start_step=0 for each";
                    return Err(refused("populations held at zero before a step (start_step)").help(help));
                }
                if leads && compartment.neuron.bias_mant.get() != 0 {
                    let message = "biased compartments with inputs in step 0";
                    return Err(refused(message).help("give the first input spike to step 1 or later"));
                }
            }
        }
        Ok(())
    }

    /// The least and the greatest delay of the synapses that these messages reach.
    fn delays(&self, messages: impl Iterator<Item = AxonTarget>) -> (u8, u8) {
        let program = self.program();
        let of = |message: AxonTarget| program.class_of(message.core).inputs.get(usize::from(message.axon)).stored;
        let delays = messages.flat_map(of).map(|synapse| synapse.delay.get());
        let (least, most) = delays.fold((u8::MAX, 0), |(least, most), delay| (least.min(delay), most.max(delay)));
        (least.min(most), most)
    }

    /// Steps from an input spike to its arrival, by nsim's count: 0 or 1.
    fn input_delay(&self) -> usize {
        self.delays(self.program().parts().channels.items().iter().copied()).1.into()
    }

    /// Whether a leading step is added.
    fn leads(&self) -> bool {
        self.input_delay() == 0 && !self.sample.at(0).is_empty()
    }

    /// Returns the texts of `arch.yaml` and `snn.yaml`.
    ///
    /// # Errors
    /// `export.sanafe` for features that the format lacks.
    pub fn files(&self) -> Result<[String; 2], Diagnostic> {
        if self.sample.steps() == 0 {
            return Err(refused("a sample without timesteps"));
        }
        self.check()?;
        Ok([self.architecture(), self.network()])
    }

    fn architecture(&self) -> String {
        let ((width, height), table) = (self.size(), self.table);
        let mut out = format!(
            "# {} for SANA-FE 2.2, constants {}; written by nsim energy --export-sanafe.\n\
             architecture:\n  name: nsim\n  attributes: {{topology: mesh, width: {width}, height: {height}, \
             link_buffer_size: {}, sync_model: fixed, latency_sync: {}}}\n  tile:\n",
            self.compiled.target,
            table.name(),
            table.link_buffer,
            seconds(table.barrier(self.tiles_used, self.compiled.program.cores().len() as u64)),
        );
        let ports = self.ports();
        let mut number = 0;
        while number < width * height {
            let at = |number: u32| (number / height, number % height);
            let run = (number..width * height).take_while(|&n| !ports.contains_key(&at(n))).count() as u32;
            let channels = if run == 0 { ports.get(&at(number)).map(Vec::len) } else { None };
            let last = number + run.max(1) - 1;
            let name = if last > number { format!("tile[{number}..{last}]") } else { format!("tile{number}") };
            self.tile_text(&mut out, &name, channels);
            number = last + 1;
        }
        out
    }

    fn tile_text(&self, out: &mut String, name: &str, inputs: Option<usize>) {
        let (table, mesh) = (self.table, self.program().mesh());
        let (ns, ew) = ((table.hop_ns_energy, table.hop_ns_time), (table.hop_ew_energy, table.hop_ew_time));
        let hops = [("north_hop", ns), ("east_hop", ew), ("south_hop", ns), ("west_hop", ew)];
        let hops = hops.map(|(hop, cost)| costs(hop, cost)).join(", ");
        let _ = write!(out, "    - name: {name}\n      attributes: {{{hops}}}\n      core:\n");
        let cores = mesh.cores_per_tile;
        let range = if cores > 1 { format!("core[0..{}]", cores - 1) } else { "core".to_string() };
        let most = self.program().classes().iter().map(|class| class.compartments.len()).max().unwrap_or(1);
        self.core_text(out, &range, most, false);
        if let Some(inputs) = inputs {
            self.core_text(out, "port", inputs, true);
        }
    }

    fn core_text(&self, out: &mut String, name: &str, neurons: usize, is_port: bool) {
        let table = self.table;
        fn soma(name: &str, model: &str, [visit, update, spike]: [(Femtojoules, Picoseconds); 3]) -> String {
            let costs = [costs("access_neuron", visit), costs("update_neuron", update), costs("spike_out", spike)];
            let costs = costs.join(", ");
            format!("            - {{name: \"{name}\", attributes: {{model: {model}, {costs}}}}}\n")
        }
        let synapse = |name: &str, energy, time| {
            let costs = costs("process_spike", (energy, time));
            format!("            - {{name: {name}, attributes: {{model: current_based, {costs}}}}}\n")
        };
        let none = (Femtojoules(0), Picoseconds(0));
        let message_in = costs("message_in", (table.axon_in_energy, table.axon_in_time));
        let message_out = if is_port { none } else { (table.axon_out_energy, table.axon_out_time) };
        let message_out = costs("message_out", message_out);
        let somas = match neurons {
            1 if is_port => soma("input0", "input", [none; 3]),
            inputs if is_port => soma(&format!("input[0..{}]", inputs - 1), "input", [none; 3]),
            _ => {
                let spike = (table.spike_energy, table.spike_time);
                let visit = (table.compartment_energy + table.dendrite_energy, table.compartment_time);
                let update = (table.compartment_active_energy, table.compartment_active_time);
                soma("lif", "leaky_integrate_fire", [visit, update, spike])
            }
        };
        let _ = write!(
            out,
            "        - name: {name}\n          attributes: {{buffer_position: soma, buffer_inside_unit: false, \
             max_neurons_supported: {neurons}}}\n          axon_in:\n            - {{name: in, attributes: \
             {{{message_in}}}}}\n          soma:\n{somas}          dendrite:\n\
             \x20           - {{name: dendrite, attributes: {{model: accumulator, energy_update: 0.0, \
             latency_update: 0.0}}}}\n          synapse:\n{}{}          axon_out:\n            - {{name: out, \
             attributes: {{{message_out}}}}}\n",
            synapse("dense", table.synapse_dense_energy, table.synapse_dense_time),
            synapse("sparse", table.synapse_sparse_energy, table.synapse_sparse_time),
        );
    }

    fn network(&self) -> String {
        let (program, leads, delay) = (self.program(), self.leads(), self.input_delay());
        let steps = self.sample.steps() as usize + usize::from(leads);
        let mut out = format!(
            "# {} for SANA-FE 2.2; written by nsim energy --export-sanafe.\n\
             # run: timesteps={steps} leading={} mixed={}\n\
             # Run it for this many timesteps; of those, `leading` go before nsim's first. Synaptic events of the last \
             timestep's\n# spikes are charged by SANA-FE and not by nsim, whose samples end before they arrive. \
             `mixed` compartments are\n# reached by dense and sparse lists and charged here as if all were of one \
             kind.\nnetwork:\n  name: nsim\n  groups:\n",
            self.compiled.one.parts().name,
            u32::from(leads),
            mixed(program),
        );
        let ports: Vec<((u32, u32), Vec<usize>)> = self.ports().into_iter().collect();
        let mut fired = vec![vec![false; steps]; program.channels() as usize];
        for step in 0..self.sample.steps() {
            for channel in self.sample.at(step) {
                // Sent a step before it arrives.
                if let Some(sent) = (step as usize + usize::from(leads) + delay).checked_sub(1) {
                    fired[channel.index()][sent] = true;
                }
            }
        }
        let digits = |fired: &Vec<bool>| fired.iter().map(|&fired| if fired { "1" } else { "0" }).collect::<Vec<_>>();
        let trains: Vec<String> = fired.iter().map(|fired| digits(fired).join(", ")).collect();
        for (port, (_, channels)) in ports.iter().enumerate() {
            let _ = writeln!(out, "    - name: in{port}\n      attributes: []\n      neurons:");
            for (index, &channel) in channels.iter().enumerate() {
                let _ = writeln!(out, "        - {index}: [spikes: [{}]]", trains[channel]);
            }
        }
        for core in program.cores().ids() {
            let class = program.class_of(core);
            let _ = writeln!(out, "    - name: c{}\n      attributes: []\n      neurons:", core.0);
            let (units, semantics) = (units(class), program.parts().semantics);
            let texts: Vec<String> =
                class.compartments.iter().zip(&units).map(|(one, unit)| attributes(one, semantics, unit)).collect();
            let mut first = 0;
            for run in texts.chunk_by(|a, b| a == b) {
                let last = first + run.len() - 1;
                let range = if last > first { format!("{first}..{last}") } else { first.to_string() };
                let _ = writeln!(out, "        - {range}: {}", run[0]);
                first = last + 1;
            }
        }
        out.push_str("  edges:\n");
        for (port, (corner, channels)) in ports.iter().enumerate() {
            for (index, &channel) in channels.iter().enumerate() {
                let messages = program.parts().channels.get(channel).iter().filter(|m| self.corner(m.core) == *corner);
                messages.for_each(|&message| self.edges(&mut out, &format!("in{port}.{index}"), message));
            }
        }
        for (core, image) in program.cores().enumerate() {
            for (slot, messages) in image.axons_out.iter().enumerate() {
                messages.for_each(|message| self.edges(&mut out, &format!("c{}.{slot}", core.0), message));
            }
        }
        out.push_str("mappings:\n");
        let cores_per_tile = program.mesh().cores_per_tile;
        for (port, (corner, channels)) in ports.iter().enumerate() {
            let tile = self.tile(*corner);
            for index in 0..channels.len() {
                let soma = if channels.len() > 1 { format!("input[{index}]") } else { "input0".to_string() };
                let _ = writeln!(out, "  - in{port}.{index}: [core: {tile}.{cores_per_tile}, soma: \"{soma}\"]");
            }
        }
        for (core, image) in program.cores().enumerate() {
            let tile = self.tile(program.mesh().tile(image.site));
            let _ = writeln!(out, "  - c{}: [core: {tile}.{}, soma: lif]", core.0, image.site.core);
        }
        out
    }

    /// Writes the synapses that a message reaches.
    fn edges(&self, out: &mut String, from: &str, message: AxonTarget) {
        let class = self.program().class_of(message.core);
        for synapse in class.inputs.get(usize::from(message.axon)).synapses() {
            let format = class.formats[usize::from(synapse.format)].synapse;
            let weight = f64::from(scaled(format, synapse.weight)) / 64.0;
            let _ = writeln!(out, "    - {from} -> c{}.{}: [weight: {weight:?}]", message.core.0, synapse.slot);
        }
    }
}
