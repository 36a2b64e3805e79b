//! The kinds of mutations: each changes one random thing of a program, and states the check that
//! should notice first.

use std::sync::Arc;

use nsim::check::verify::Violation;
use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::csr::Csr;
use nsim::ir::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, MessageBits, Payload, Refractory, SignMode, ThresholdMantissa,
    VmaxExponent, VminExponent, WeightBits, WeightExponent,
};
use nsim::ir::base::id::{ClassId, CompartmentId, CoreId, Id, PopulationId, RuleId};
use nsim::ir::neurons::{NeuronKind, Port};
use nsim::ir::program::{AxonTarget, AxonsOut, CoreClass, CoreFormat, InputAxon, Parts, PopulationAxon, Synapse};
use nsim::ir::quantised::connectivity::SeparateSum;
use nsim::ir::quantised::{Neuron, Reset};
use nsim::ir::spikes::Message;

use crate::common::random::Draw;

/// Expected verdict of `Program::new` and the verifier on a mutated program.
pub enum Expected {
    /// `Program::new` refuses it.
    NotClosed,
    /// The verifier reports a violation of this rule.
    Breaks(fn(&Violation) -> bool),
    /// The verifier finds nothing.
    Verified,
    /// It is closed; the verifier may find something, depending on the random choice.
    Closed,
    /// The verdict depends on the random choice.
    Anything,
}

use Expected::{Anything, Breaks, Closed, NotClosed, Verified};
use SignMode::{Excitatory, Inhibitory};

const BREAKS_FORMAT: Expected = Breaks(|v| matches!(v, Violation::Format { .. }));

/// Changes a program; returns `None` if the program has no place for the change.
pub type Kind = fn(&mut Parts, &mut Draw) -> Option<Expected>;

/// Every kind with its name.
pub const KINDS: &[(&str, Kind)] = &[
    // Compartments.
    ("current decay", |p, d| field(p, d, |n, d| n.du = Decay::new(d.from(0, 4096)).unwrap())),
    ("voltage decay", |p, d| field(p, d, |n, d| n.dv = Decay::new(d.from(0, 4096)).unwrap())),
    ("threshold", |p, d| field(p, d, |n, d| n.vth = ThresholdMantissa::new(d.from(0, 131_071)).unwrap())),
    ("bias mantissa", |p, d| field(p, d, |n, d| n.bias_mant = BiasMantissa::new(d.from(-4096, 4095)).unwrap())),
    ("bias exponent", |p, d| field(p, d, |n, d| n.bias_exp = BiasExponent::new(d.from(0, 7)).unwrap())),
    ("refractory period", |p, d| field(p, d, |n, d| n.refractory = Refractory::new(d.from(0, 63)).unwrap())),
    ("lower clip", |p, d| field(p, d, |n, d| n.vmin = VminExponent::new(d.from(0, 23)).unwrap())),
    ("upper clip", |p, d| field(p, d, |n, d| n.vmax = VmaxExponent::new(d.from(0, 7)).unwrap())),
    ("parameter of a row", |p, d| {
        let (core, slot) = compartment(p, d);
        let neuron = &mut p.class_mut(core).compartments[slot].neuron;
        let parameters = neuron.kind.parameters();
        let place = d.from(0, neuron.row.0.len() as i64 - 1) as usize;
        let field = parameters.get(place).filter(|_| !neuron.kind.table().registers)?.field;
        neuron.row.0[place] = d.from(field.low, field.high) as i32;
        Some(Closed)
    }),
    ("kind of a neuron", |p, d| {
        let (core, slot) = compartment(p, d);
        p.class_mut(core).compartments[slot].neuron.kind = d.one_of(&NeuronKind::ALL);
        // A synapse may then lead to a missing sum.
        Some(Anything)
    }),
    ("what messages carry", |p, d| {
        let bits = MessageBits::new(d.from(1, 32)).unwrap();
        let payload = Payload::new(d.from(-9, 9)).unwrap();
        let message = d.one_of(&[Message::Payload(payload), Message::Value(bits)]);
        let place = (d.from(0, 9) as usize).checked_rem(p.graded.len())?;
        p.graded[place].message = message;
        Some(Verified)
    }),
    ("messages that carry two payloads", |p, d| {
        let place = (d.from(0, 9) as usize).checked_rem(p.graded.len())?;
        p.graded.push(p.graded[place].clone());
        Some(NotClosed)
    }),
    ("messages that carry nothing", |p, d| {
        let place = (d.from(0, 9) as usize).checked_rem(p.graded.len())?;
        p.graded.remove(place);
        Some(Verified)
    }),
    ("sources of what messages carry", |p, d| {
        let place = (d.from(0, 9) as usize).checked_rem(p.graded.len())?;
        let sources = &mut p.graded[place].sources;
        sources.end = d.from(sources.start.into(), i64::from(sources.end) + 2) as u32;
        Some(Anything)
    }),
    // Formats may then be equal, or lead to a missing sum.
    ("port of a format", |p, d| {
        format_field(p, d, Anything, |format, _| {
            format.synapse.port = if format.synapse.port.is_first() { Port::Second } else { Port::First };
        })
    }),
    ("plastic format", |p, d| {
        format_field(p, d, Anything, |format, _| format.synapse.rule = format.synapse.rule.xor(Some(RuleId(0))))
    }),
    ("start step", |p, d| {
        let (core, slot) = compartment(p, d);
        p.class_mut(core).compartments[slot].start_step += d.from(1, 9) as u32;
        Some(Verified)
    }),
    ("parameters of two compartments swapped", |p, d| {
        let (core, slot) = compartment(p, d);
        let other = d.from(0, p.class_of(core).compartments.len() as i64 - 1) as usize;
        p.class_mut(core).compartments.swap(slot, other);
        Some(Verified)
    }),
    ("seats of two compartments swapped", |p, d| {
        let [a, b] = [0, 1].map(|_| CompartmentId::new(d.from(0, p.seats.len() as i64 - 1) as usize));
        let (at_a, at_b) = (p.seats[a], p.seats[b]);
        let seats = Arc::make_mut(&mut p.seats);
        (seats[a], seats[b]) = (at_b, at_a);
        Arc::make_mut(&mut p.cores[at_a.core].ids)[usize::from(at_a.slot)] = b;
        Arc::make_mut(&mut p.cores[at_b.core].ids)[usize::from(at_b.slot)] = a;
        Some(Verified)
    }),
    ("seat of another compartment", |p, d| {
        let [a, b] = [0, 1].map(|_| CompartmentId::new(d.from(0, p.seats.len() as i64 - 1) as usize));
        let seat = p.seats[b];
        Arc::make_mut(&mut p.seats)[a] = seat;
        Some(NotClosed)
    }),
    ("identity of another compartment", |p, d| {
        let (core, slot) = compartment(p, d);
        let id = CompartmentId::new(d.from(0, p.seats.len() as i64) as usize);
        Arc::make_mut(&mut p.cores[core].ids)[slot] = id;
        Some(NotClosed)
    }),
    ("a compartment too many", |p, d| {
        let (core, slot) = compartment(p, d);
        let class = p.class_mut(core);
        let again = class.compartments[slot];
        class.compartments.push(again);
        Some(NotClosed)
    }),
    ("a compartment too few", |p, d| {
        let (core, _) = compartment(p, d);
        p.class_mut(core).compartments.pop();
        let image = &mut p.cores[core];
        Arc::make_mut(&mut image.ids).pop();
        edit_out(&mut image.axons_out, |lists| edit(lists, |lists| drop(lists.pop())));
        Some(NotClosed)
    }),
    // Classes.
    ("class of another core", |p, d| {
        let [(core, _), (other, _)] = [0, 1].map(|_| compartment(p, d));
        let (own, new) = (p.cores[core].class, p.cores[other].class);
        p.cores[core].class = new;
        let left = p.cores.iter().any(|image| image.class == own);
        Some(if left { Anything } else { NotClosed })
    }),
    ("a class that does not exist", |p, d| {
        let (core, _) = compartment(p, d);
        p.cores[core].class = ClassId(p.classes.len() as u32 + d.from(0, 9) as u32);
        Some(NotClosed)
    }),
    ("tables of another core", |p, d| {
        let [(core, _), (other, _)] = [0, 1].map(|_| compartment(p, d));
        *p.class_mut(core) = p.class_of(other).clone();
        Some(Anything)
    }),
    // Synapse words.
    ("weight by a step", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let format = format_of(p.class_of(core), at).synapse;
        let (low, high) = format.sign.range(format.bits);
        let (step, weight) =
            (format.sign.step(format.bits), &mut p.class_mut(core).inputs.lists.items_mut()[at].weight);
        let up = (*weight + step <= high) && (d.chance(50) || *weight - step < low);
        *weight += if up { step } else { -step };
        (low..=high).contains(weight).then_some(Verified)
    }),
    ("weight between steps", |p, d| {
        let (core, at) = synapse(p, d, |image, at| {
            let format = format_of(image, at).synapse;
            format.sign.step(format.bits) > 1
        })?;
        p.class_mut(core).inputs.lists.items_mut()[at].weight += 1;
        Some(Breaks(|v| matches!(v, Violation::Weight { .. })))
    }),
    ("weight outside its bits", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let format = format_of(p.class_of(core), at).synapse;
        let (low, high) = format.sign.range(format.bits);
        let step = format.sign.step(format.bits);
        p.class_mut(core).inputs.lists.items_mut()[at].weight = if d.chance(50) { low - step } else { high + step };
        Some(Breaks(|v| matches!(v, Violation::Weight { .. })))
    }),
    ("weight of zero", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        p.class_mut(core).inputs.lists.items_mut()[at].weight = 0;
        Some(Verified)
    }),
    ("weight of zero in tables that several cores share", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let class = p.cores[core].class;
        let shared = p.cores.iter().filter(|image| image.class == class).count() > 1;
        p.classes[class].inputs.lists.items_mut()[at].weight = 0;
        shared.then_some(Verified)
    }),
    ("weight of another synapse", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let synapses = p.class_mut(core).inputs.lists.items_mut();
        let other = d.from(0, synapses.len() as i64 - 1) as usize;
        let weight = synapses[other].weight;
        let same = synapses[other].format == synapses[at].format;
        synapses[at].weight = weight;
        Some(if same { Verified } else { Closed })
    }),
    ("target of a synapse", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let slots = p.class_of(core).compartments.len() as i64;
        p.class_mut(core).inputs.lists.items_mut()[at].slot = d.from(0, slots - 1) as u16;
        // The lists of population axons are shifted, and may then lead outside.
        Some(if p.class_of(core).inputs.populations.is_empty() { Closed } else { Anything })
    }),
    ("target outside the core", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let slots = p.class_of(core).compartments.len() as i64;
        p.class_mut(core).inputs.lists.items_mut()[at].slot = (slots + d.from(0, 100)) as u16;
        Some(NotClosed)
    }),
    ("neighbours swapped", |p, d| {
        let (core, at) = synapse(p, d, |image, at| {
            let same = |a: Synapse, b: Synapse| a.format == b.format && a.slot != b.slot;
            next_of(image, at).is_some_and(|next| same(image.inputs.lists.items()[at], next))
        })?;
        p.class_mut(core).inputs.lists.items_mut().swap(at, at + 1);
        Some(Breaks(|v| matches!(v, Violation::Slots { .. })))
    }),
    ("delay without bits for it", |p, d| {
        let (core, at) = synapse(p, d, |image, at| format_of(image, at).delay_bits == 0)?;
        let longest = p.class_of(core).inputs.lists.items().iter().map(|s| s.delay).max()?;
        if longest == Delay::MIN {
            // The first delay of a core gives it delay fields; its formats have none.
            p.class_mut(core).inputs.lists.items_mut()[at].delay = Delay::new(d.from(1, 62)).unwrap();
        } else {
            p.class_mut(core).inputs.lists.items_mut()[at].delay = longest;
        }
        Some(Breaks(|v| matches!(v, Violation::Delay { .. })))
    }),
    ("delay beyond its bits", |p, d| {
        let (core, at) = synapse(p, d, |image, at| (1..6).contains(&format_of(image, at).delay_bits))?;
        let bits = format_of(p.class_of(core), at).delay_bits;
        p.class_mut(core).inputs.lists.items_mut()[at].delay = Delay::new(d.from(1 << bits, 62)).unwrap();
        // The core's delays then exceed the width in its formats.
        Some(Breaks(|v| matches!(v, Violation::Format { .. } | Violation::Delay { .. })))
    }),
    ("another delay", |p, d| {
        let (core, at) = synapse(p, d, |image, at| format_of(image, at).delay_bits > 0)?;
        p.class_mut(core).inputs.lists.items_mut()[at].delay = Delay::new(d.from(0, 62)).unwrap();
        Some(Closed)
    }),
    ("format that is not there", |p, d| {
        let (core, at) = synapse(p, d, |_, _| true)?;
        let formats = p.class_of(core).formats.len() as i64;
        p.class_mut(core).inputs.lists.items_mut()[at].format = d.from(formats, 255) as u8;
        Some(NotClosed)
    }),
    ("format of others", |p, d| {
        let (core, at) = synapse(p, d, |image, _| image.formats.len() > 1)?;
        let formats = p.class_of(core).formats.len() as i64;
        p.class_mut(core).inputs.lists.items_mut()[at].format = d.from(0, formats - 1) as u8;
        Some(Closed)
    }),
    ("a synapse too few", |p, d| {
        let (core, list) = list(p, d, |list| list.len() > 1)?;
        edit(&mut p.class_mut(core).inputs.lists, |lists| shorten(&mut lists[list]));
        Some(Closed)
    }),
    ("a synapse twice", |p, d| {
        let (core, list) = list(p, d, |list| !list.is_empty())?;
        let image = p.class_mut(core);
        let last = *image.inputs.lists.get(list).last()?;
        let format = image.formats[usize::from(last.format)];
        edit(&mut image.inputs.lists, |lists| lists[list].push(last));
        let repeats = format.index_bits.is_some() && format.skip_bits.is_none();
        Some(if repeats { Verified } else { Breaks(|v| matches!(v, Violation::Slots { .. })) })
    }),
    ("a list without synapses", |p, d| {
        let (core, list) = list(p, d, |list| !list.is_empty())?;
        edit(&mut p.class_mut(core).inputs.lists, |lists| lists[list].clear());
        // It may have had the only long delays of the core, whose formats then have too many bits.
        Some(Breaks(|v| matches!(v, Violation::EmptyAxon { .. } | Violation::Format { .. })))
    }),
    ("two lists swapped", |p, d| {
        let (core, a) = list(p, d, |_| true)?;
        let b = d.from(0, p.class_of(core).inputs.lists.len() as i64 - 1) as usize;
        edit(&mut p.class_mut(core).inputs.lists, |lists| lists.swap(a, b));
        Some(if p.class_of(core).inputs.populations.is_empty() { Verified } else { Anything })
    }),
    ("a list too few", |p, d| {
        let (core, _) = list(p, d, |_| true)?;
        edit(&mut p.class_mut(core).inputs.lists, shorten);
        Some(NotClosed)
    }),
    ("a list too many", |p, d| {
        let (core, list) = list(p, d, |_| true)?;
        edit(&mut p.class_mut(core).inputs.lists, |lists| lists.push(lists[list].clone()));
        Some(NotClosed)
    }),
    ("synapses of one format in two places", |p, d| {
        let (core, at) = synapse(p, d, |image, at| {
            let (items, format) = (image.inputs.lists.items(), format_of(image, at));
            let within = |at: usize| next_of(image, at).is_some_and(|next| next.format == items[at].format);
            at > 0 && within(at - 1) && within(at) && format.delay_bits == 0 && format.index_bits.is_some()
        })?;
        let image = p.class_mut(core);
        let dense = CoreFormat { index_bits: None, skip_bits: None, ..format_of(image, at) };
        let number = image.formats.iter().position(|format| *format == dense).unwrap_or_else(|| {
            image.formats.push(dense);
            image.formats.len() - 1
        });
        image.inputs.lists.items_mut()[at].format = number as u8;
        Some(Breaks(|v| matches!(v, Violation::Scattered { .. })))
    }),
    // Formats.
    ("exponent of a format", |p, d| {
        let (core, at) = format_at(p, d)?;
        let image = p.class_mut(core);
        let new = WeightExponent::new(d.from(-8, 7)).unwrap();
        if image.formats.iter().any(|format| format.synapse.exponent == new) {
            return None;
        }
        image.formats[at].synapse.exponent = new;
        Some(Verified)
    }),
    ("sign mode of a format", |p, d| {
        format_field(p, d, Closed, |f, d| f.synapse.sign = d.one_of(&[SignMode::Mixed, Excitatory, Inhibitory]))
    }),
    ("sum of a format", |p, d| {
        format_field(p, d, Anything, |f, d| {
            let apart = SeparateSum { number: d.from(0, 70) as u8, wraps: d.chance(50) };
            f.synapse.apart = Some(apart).filter(|_| d.chance(80));
        })
    }),
    ("bits of a format", |p, d| {
        format_field(p, d, Closed, |f, d| {
            f.synapse.bits = WeightBits::new(d.one_of(&[2, 3, 4, 5, 6, 8])).unwrap();
        })
    }),
    ("weights of seven bits", |p, d| {
        format_field(p, d, BREAKS_FORMAT, |f, _| f.synapse.bits = WeightBits::new(7).unwrap())
    }),
    ("a rule that the program lacks", |p, d| {
        format_field(p, d, BREAKS_FORMAT, |f, _| f.synapse.rule = Some(RuleId(99)))
    }),
    // Widths that are neither 0 nor any core's.
    ("delay bits of a format", |p, d| format_field(p, d, BREAKS_FORMAT, |f, d| f.delay_bits = d.from(7, 20) as u8)),
    ("index bits of a format", |p, d| {
        format_field(p, d, BREAKS_FORMAT, |f, d| f.index_bits = Some(d.from(12, 20) as u8))
    }),
    ("run bits of a format", |p, d| format_field(p, d, BREAKS_FORMAT, |f, d| f.skip_bits = Some(d.from(9, 20) as u8))),
    ("a format twice", |p, d| {
        let (core, at) = format_at(p, d)?;
        let image = p.class_mut(core);
        image.formats.push(image.formats[at]);
        Some(Breaks(|v| matches!(v, Violation::Format { what, .. } if what.contains("duplicated"))))
    }),
    ("a format that nothing uses", |p, d| {
        let (core, at) = format_at(p, d)?;
        let image = p.class_mut(core);
        let mut format: CoreFormat = image.formats[at];
        format.synapse.exponent = WeightExponent::new(d.from(-8, 7)).unwrap();
        if image.formats.contains(&format) {
            return None;
        }
        image.formats.push(format);
        Some(Breaks(|v| matches!(v, Violation::Format { what, .. } if what.contains("not used"))))
    }),
    // Axon tables.
    ("base of a population axon off by one", |p, d| population_field(p, d, Anything, |axon| axon.base += 1)),
    ("base of a population axon off by four", |p, d| population_field(p, d, Anything, |axon| axon.base += 4)),
    ("table of a population axon", |p, d| population_field(p, d, Anything, |axon| axon.table += 1)),
    ("atoms of a population axon", |p, d| population_field(p, d, Anything, |axon| axon.atoms += 1)),
    ("a population axon without atoms", |p, d| population_field(p, d, NotClosed, |axon| axon.atoms = 0)),
    ("a population axon too many", |p, d| {
        let copy = *population(p, d)?;
        let core = p.cores.ids().find(|&core| p.class_of(core).inputs.populations.contains(&copy))?;
        p.class_mut(core).inputs.populations.push(copy);
        // The axon has lists, and no source selects them.
        Some(Breaks(|v| matches!(v, Violation::EmptyAxon { .. } | Violation::Population { .. })))
    }),
    ("input axons swapped", |p, d| {
        let core = core(p, d, |image| image.inputs.axons.len() > 1)?;
        let axons = &mut p.class_mut(core).inputs.axons;
        let [a, b] = [0, 1].map(|_| d.from(0, axons.len() as i64 - 1) as usize);
        axons.swap(a, b);
        Some(Closed)
    }),
    ("an input axon too few", |p, d| {
        let core = core(p, d, |image| !image.inputs.axons.is_empty())?;
        p.class_mut(core).inputs.axons.pop();
        Some(Anything)
    }),
    ("atom of an input axon", |p, d| {
        let core = core(p, d, |image| image.inputs.axons.iter().any(|a| matches!(a, InputAxon::Member { .. })))?;
        let members = p.class_mut(core).inputs.axons.iter_mut().filter(|axon| matches!(axon, InputAxon::Member { .. }));
        let mut members: Vec<&mut InputAxon> = members.collect();
        let chosen = d.from(0, members.len() as i64 - 1) as usize;
        if let InputAxon::Member { atom, .. } = &mut *members[chosen] {
            *atom += 1;
        }
        Some(Anything)
    }),
    // Routes.
    ("a message too few", |p, d| {
        messages(p, d, 1, |lists, at| {
            edit(lists, |lists| shorten(&mut lists[at]));
            Some(NotClosed)
        })
    }),
    ("a message twice", |p, d| {
        messages(p, d, 1, |lists, at| {
            let again = |lists: &mut Vec<Vec<AxonTarget>>| {
                let copy = lists[at][0];
                lists[at].push(copy);
            };
            edit(lists, again);
            Some(NotClosed)
        })
    }),
    ("a message to a core that is not there", |p, d| {
        let cores = p.cores.len() as i64;
        let core = CoreId(d.from(cores, cores + 99) as u32);
        messages(p, d, 1, |lists, at| {
            lists.get_mut(at)[0].core = core;
            Some(NotClosed)
        })
    }),
    ("a message to another core", |p, d| {
        let cores = p.cores.len() as i64;
        let core = CoreId(d.from(0, cores - 1) as u32);
        // Two messages then meet at one axon, or an axon receives none.
        messages(p, d, 1, |lists, at| {
            lists.get_mut(at)[0].core = core;
            Some(NotClosed)
        })
    }),
    ("a message to another axon", |p, d| {
        let bits = d.from(1, 9) as u16;
        messages(p, d, 1, |lists, at| {
            lists.get_mut(at)[0].axon ^= bits;
            Some(NotClosed)
        })
    }),
    ("messages in descending order", |p, d| {
        messages(p, d, 2, |lists, at| {
            lists.get_mut(at).reverse();
            Some(Breaks(|v| matches!(v, Violation::Multicast(_))))
        })
    }),
    ("messages of two channels swapped", |p, d| {
        let [a, b] = [0, 1].map(|_| d.from(0, p.channels.len() as i64 - 1) as usize);
        edit(&mut p.channels, |lists| lists.swap(a, b));
        // The core keeps its own population axons.
        Some(Verified)
    }),
    ("messages of two compartments swapped", |p, d| {
        let (core, a) = compartment(p, d);
        let b = d.from(0, p.class_of(core).compartments.len() as i64 - 1) as usize;
        edit_out(&mut p.cores[core].axons_out, |lists| edit(lists, |lists| lists.swap(a, b)));
        Some(Verified)
    }),
    ("axons of two messages swapped", |p, d| {
        let populations = p.classes.iter().any(|class| !class.inputs.populations.is_empty());
        let chosen = d.from(0, i64::from(u16::MAX)) as usize;
        messages(p, d, 1, |lists, a| {
            let first = lists.get(a)[0];
            let at_core = |list: &[AxonTarget]| list.iter().any(|m| m.core == first.core && m.axon != first.axon);
            let others: Vec<usize> = (0..lists.len()).filter(|&b| b != a && at_core(lists.get(b))).collect();
            let b = *others.get(chosen.checked_rem(others.len())?)?;
            let second = lists.get_mut(b).iter_mut().find(|m| m.core == first.core)?;
            let axon = std::mem::replace(&mut second.axon, first.axon);
            lists.get_mut(a)[0].axon = axon;
            Some(if populations { Closed } else { Verified })
        })
    }),
    // Sites.
    ("a core outside its mesh", |p, d| {
        let (core, _) = compartment(p, d);
        let (width, height) = (p.mesh.width, p.mesh.height);
        let site = &mut p.cores[core].site;
        match d.from(0, 3) {
            0 => site.x = width + d.from(0, 9) as u32,
            1 => site.y = height + d.from(0, 9) as u32,
            2 => site.core = 4 + d.from(0, 9) as u32,
            _ => site.chip += d.from(1, 9) as u32,
        }
        Some(NotClosed)
    }),
    ("two cores at one place", |p, d| {
        if p.cores.len() < 2 {
            return None;
        }
        let a = d.from(0, p.cores.len() as i64 - 2) as usize;
        let b = d.from(a as i64 + 1, p.cores.len() as i64 - 1) as usize;
        p.cores[CoreId::new(b)].site = p.cores[CoreId::new(a)].site;
        Some(Breaks(|v| matches!(v, Violation::Site { .. })))
    }),
    ("a core at a free place", |p, d| {
        let (core, _) = compartment(p, d);
        let site = p.mesh.site(d.from(0, i64::from(p.mesh.cores()) - 1) as u32)?;
        if p.cores.iter().any(|image| image.site == site) {
            return None;
        }
        p.cores[core].site = site;
        // This changes the cost of a run, not its results.
        Some(Verified)
    }),
    ("a larger board", |p, d| {
        p.mesh.chips_x += d.from(1, 3) as u32;
        Some(Breaks(|v| matches!(v, Violation::Mesh)))
    }),
    // The frame.
    ("a channel too many", |p, _| {
        p.channels.push([]);
        Some(Verified)
    }),
    ("another output", |p, d| {
        let count = p.populations.len() as i64;
        p.output = PopulationId::new(d.from(0, count - 1) as usize);
        let compartments = p.populations[p.output].is_some();
        Some(if compartments { Verified } else { NotClosed })
    }),
    ("size of a population", |p, d| {
        let count = p.populations.len() as i64;
        let population = p.populations[PopulationId::new(d.from(0, count - 1) as usize)].as_mut()?;
        if d.chance(50) {
            population.count += 1;
            return Some(Verified);
        }
        population.positions += 1;
        Some(Anything)
    }),
    ("semantics", |p, d| {
        p.semantics = d.one_of(&[Semantics::Hardware, Semantics::Lava, Semantics::Slayer]);
        Some(Verified)
    }),
    ("threshold test", |p, _| {
        p.threshold = match p.threshold {
            ThresholdTest::Strict => ThresholdTest::Inclusive,
            ThresholdTest::Inclusive => ThresholdTest::Strict,
        };
        Some(Verified)
    }),
    ("reset", |p, d| {
        p.reset = d.chance(70).then(|| Reset { interval: d.from(1, 20) as u32, offset: d.from(0, 5) as u32 });
        Some(Verified)
    }),
];

/// Changes lists, which may then have other lengths.
fn edit<T: Copy>(lists: &mut Csr<T>, change: impl FnOnce(&mut Vec<Vec<T>>)) {
    let mut all: Vec<Vec<T>> = lists.iter().map(<[T]>::to_vec).collect();
    change(&mut all);
    *lists = Csr::default();
    all.into_iter().for_each(|list| lists.push(list));
}

/// Removes the last item.
fn shorten<T>(list: &mut Vec<T>) {
    list.pop();
}

/// A random core whose class fits.
fn core(parts: &Parts, draw: &mut Draw, fits: impl Fn(&CoreClass) -> bool) -> Option<CoreId> {
    let fitting: Vec<CoreId> = parts.cores.ids().filter(|&core| fits(parts.class_of(core))).collect();
    (!fitting.is_empty()).then(|| draw.one_of(&fitting))
}

/// Core and slot of a random compartment.
fn compartment(parts: &Parts, draw: &mut Draw) -> (CoreId, usize) {
    let seat = parts.seats[CompartmentId::new(draw.from(0, parts.seats.len() as i64 - 1) as usize)];
    (seat.core, usize::from(seat.slot))
}

/// Changes a field of a random compartment.
fn field(parts: &mut Parts, draw: &mut Draw, change: fn(&mut Neuron, &mut Draw)) -> Option<Expected> {
    let (core, slot) = compartment(parts, draw);
    change(&mut parts.class_mut(core).compartments[slot].neuron, draw);
    Some(Verified)
}

/// A random stored synapse that fits: its core, and its number among all of the core.
fn synapse(parts: &Parts, draw: &mut Draw, fits: impl Fn(&CoreClass, usize) -> bool) -> Option<(CoreId, usize)> {
    let fitting = |image: &CoreClass| (0..image.inputs.lists.items().len()).filter(|&at| fits(image, at)).collect();
    let core = core(parts, draw, |image| (0..image.inputs.lists.items().len()).any(|at| fits(image, at)))?;
    let fitting: Vec<usize> = fitting(parts.class_of(core));
    Some((core, draw.one_of(&fitting)))
}

fn format_of(image: &CoreClass, synapse: usize) -> CoreFormat {
    image.formats[usize::from(image.inputs.lists.items()[synapse].format)]
}

/// The next synapse of this one's list.
fn next_of(image: &CoreClass, synapse: usize) -> Option<Synapse> {
    let ends = image.inputs.lists.firsts().contains(&(synapse as u32 + 1));
    (!ends).then(|| image.inputs.lists.items()[synapse + 1])
}

/// A random stored list that fits.
fn list(parts: &Parts, draw: &mut Draw, fits: impl Fn(&[Synapse]) -> bool) -> Option<(CoreId, usize)> {
    let core = core(parts, draw, |image| image.inputs.lists.iter().any(&fits))?;
    let lists = &parts.class_of(core).inputs.lists;
    let fitting: Vec<usize> = (0..lists.len()).filter(|&list| fits(lists.get(list))).collect();
    Some((core, draw.one_of(&fitting)))
}

/// Changes a field of a random format.
fn format_field(
    parts: &mut Parts,
    draw: &mut Draw,
    expected: Expected,
    change: fn(&mut CoreFormat, &mut Draw),
) -> Option<Expected> {
    let (core, at) = format_at(parts, draw)?;
    change(&mut parts.class_mut(core).formats[at], draw);
    Some(expected)
}

/// Changes a field of a random population axon.
fn population_field(
    parts: &mut Parts,
    draw: &mut Draw,
    expected: Expected,
    change: fn(&mut PopulationAxon),
) -> Option<Expected> {
    change(population(parts, draw)?);
    Some(expected)
}

/// A random format.
fn format_at(parts: &Parts, draw: &mut Draw) -> Option<(CoreId, usize)> {
    let core = core(parts, draw, |image| !image.formats.is_empty())?;
    Some((core, draw.from(0, parts.class_of(core).formats.len() as i64 - 1) as usize))
}

/// A random population axon.
fn population<'a>(parts: &'a mut Parts, draw: &mut Draw) -> Option<&'a mut PopulationAxon> {
    let core = core(parts, draw, |image| !image.inputs.populations.is_empty())?;
    let axons = &mut parts.class_mut(core).inputs.populations;
    let chosen = draw.from(0, axons.len() as i64 - 1) as usize;
    Some(&mut axons[chosen])
}

/// Changes the messages of a core's compartments.
fn edit_out<T>(out: &mut AxonsOut, change: impl FnOnce(&mut Csr<AxonTarget>) -> T) -> T {
    let mut lists = Csr::default();
    out.iter().for_each(|list| lists.push(list));
    let result = change(&mut lists);
    *out = AxonsOut::try_from(lists.iter().map(<[_]>::to_vec).collect::<Vec<_>>()).unwrap();
    result
}

/// Changes the messages of all channels or of a core's compartments, in a random list of at least
/// `least` messages.
fn messages(
    parts: &mut Parts,
    draw: &mut Draw,
    least: usize,
    change: impl FnOnce(&mut Csr<AxonTarget>, usize) -> Option<Expected>,
) -> Option<Expected> {
    let fitting = |core: &CoreId| parts.cores[*core].axons_out.iter().any(|list| list.count() >= least);
    let fitting: Vec<CoreId> = parts.cores.ids().filter(fitting).collect();
    let from_core = (!fitting.is_empty()).then(|| draw.one_of(&fitting)).filter(|_| draw.chance(50));
    let at_any = |lists: &mut Csr<AxonTarget>| {
        let fitting: Vec<usize> = (0..lists.len()).filter(|&at| lists.get(at).len() >= least).collect();
        if fitting.is_empty() { None } else { change(lists, draw.one_of(&fitting)) }
    };
    match from_core {
        Some(core) => edit_out(&mut parts.cores[core].axons_out, at_any),
        None => at_any(&mut parts.channels),
    }
}
