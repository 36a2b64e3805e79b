//! The sums of arrivals of compartments whose state is words.
//!
//! Input: a program. Output: for each compartment the list of its sums, and the sum to which a
//! synapse adds. Errors: a compartment with more sums than a skip block has lanes.
//!
//! A compartment has a sum for each of its ports, and separate sums: one for each number, shift and
//! delay of its synapses. The sums of a list lie `stride` lanes from each other, within one skip
//! block, so that delivery and skipping need no ports.

use std::collections::BTreeMap;

use crate::lanes::lane_order::LaneOrder;
use nsim_dynamics::arithmetic::sum_shift;
use nsim_dynamics::kinds::MOST_LANES;
use nsim_ir::base::id::{CompartmentId, CoreId, Id};
use nsim_ir::neurons::Port;
use nsim_ir::program::Program;
use nsim_ir::quantised::connectivity::{SeparateSum, SynapseFormat};

/// A sum of a compartment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Sum {
    /// The port that it is added to.
    pub port: Port,
    /// The properties of a separate sum.
    pub separate: Option<SeparateSum>,
    /// Shift before it is added to the port, in bits.
    pub shift: u8,
    /// Delay field of the arrivals of a separate sum; 0 for the sum of a port.
    delay: u8,
}

impl Sum {
    /// The sum of a port.
    const fn of_port(port: Port) -> Sum {
        Sum { port, separate: None, shift: 0, delay: 0 }
    }

    /// The sum to which synapses of this format and delay field add.
    fn reached_by(format: SynapseFormat, delay: u8) -> Sum {
        let SynapseFormat { port, apart, .. } = format;
        let delay = if apart.is_some() { delay } else { 0 };
        Sum { port, separate: apart, shift: sum_shift(format), delay }
    }
}

/// Lanes between the sums of a list of `sums` sums.
pub(crate) const fn stride(sums: usize) -> usize {
    MOST_LANES / sums.next_power_of_two()
}

/// The sums of all compartments.
#[derive(Debug)]
pub(crate) struct Sums {
    /// Lists of sums: of one port, of two ports, then lists with separate sums.
    lists: Vec<Vec<Sum>>,
    /// The list of each compartment that has separate sums; empty if no compartment has any.
    separate: Vec<Option<u32>>,
}

impl Sums {
    /// The sums of a program. The error is a compartment with too many.
    pub fn new(program: &Program, order: &LaneOrder<'_>) -> Result<Sums, CompartmentId> {
        let ports = [Port::First, Port::Second].map(Sum::of_port);
        let mut sums = Sums { lists: vec![ports[..1].to_vec(), ports.to_vec()], separate: Vec::new() };
        let has_separate = |core: CoreId| program.class_of(core).formats.iter().any(|f| f.synapse.apart.is_some());
        for core in program.cores().ids().filter(|&core| has_separate(core)) {
            let (class, ids) = (program.class_of(core), &program.cores()[core].ids);
            // Compartments of a population have the same list.
            let mut reached: BTreeMap<usize, Vec<Sum>> = BTreeMap::new();
            for synapse in class.inputs.synapses() {
                let sum = Sum::reached_by(class.formats[usize::from(synapse.format)].synapse, synapse.delay.get());
                let own = reached.entry(order.population(ids[usize::from(synapse.slot)])).or_default();
                if let Err(place) = own.binary_search(&sum) {
                    own.insert(place, sum);
                }
            }
            sums.separate.resize(program.compartments() as usize, None);
            for &id in &**ids {
                let own = reached.get(&order.population(id)).filter(|own| own.iter().any(|sum| sum.separate.is_some()));
                let Some(own) = own else { continue };
                if own.len() > SeparateSum::MOST {
                    return Err(id);
                }
                let place = sums.lists.iter().position(|list| list == own).unwrap_or_else(|| {
                    sums.lists.push(own.clone());
                    sums.lists.len() - 1
                });
                sums.separate[id.index()] = Some(place as u32);
            }
        }
        Ok(sums)
    }

    /// The index of the list of a compartment with `ports` ports.
    pub fn list(&self, id: CompartmentId, ports: u8) -> u32 {
        self.own(id).unwrap_or_else(|| u32::from(ports) - 1)
    }

    pub fn get(&self, list: u32) -> &[Sum] {
        &self.lists[list as usize]
    }

    /// Whether each of these compartments has no separate sums, or only one sum.
    pub fn have_one_sum(&self, ids: &[CompartmentId]) -> bool {
        ids.iter().all(|&id| self.own(id).is_none_or(|list| self.get(list).len() == 1))
    }

    /// Lanes from a compartment's lane to the lane of the sum to which a synapse adds.
    #[inline]
    pub fn offset(&self, id: CompartmentId, format: SynapseFormat, delay: u8) -> u32 {
        let Some(list) = self.own(id) else { return (format.port.index() * stride(2)) as u32 };
        let (list, sum) = (self.get(list), Sum::reached_by(format, delay));
        (list.iter().position(|other| *other == sum).unwrap_or(0) * stride(list.len())) as u32
    }

    fn own(&self, id: CompartmentId) -> Option<u32> {
        self.separate.get(id.index()).copied().flatten()
    }
}
