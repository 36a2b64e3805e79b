//! A timestep of a shard, compiled for its types of sums and payloads.
//!
//! Input: the state of a shard of an [`Image`], and the spikes to deliver. Output: the state after
//! the step, with the next spikes and their payloads. The form is the narrowest whose sums are
//! exact; once a large graded spike arrives, the sums of the shard have 64 bits. Each form is
//! compiled for the widest vectors of the processor.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::blocks::Counted;
use crate::deliver::delay_ring::DelayRing;
use crate::lanes::kernel::{Portable, Sum, Vectors};
use crate::layout::image::Image;
use crate::layout::shard::Shard;
use crate::update::state::{CompartmentState, Rings, Sent, ShardState, StepInput};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id};
use nsim_ir::spikes::{GradedSpike, Spike};
use pulp::NullaryFnOnce;

/// A step of a shard.
pub(crate) struct Step<'a> {
    pub state: &'a mut ShardState,
    pub image: &'a Image,
    pub shard: &'a Shard,
    pub input: &'a StepInput<'a>,
    /// Number of spikes of each channel, which delivery counts unless this is empty.
    pub channel_counts: &'a mut [u32],
}

impl Step<'_> {
    /// Runs the step in the form of its sums and payloads.
    pub fn run(self, arch: pulp::Arch) {
        let Step { state: ShardState { state, rings }, image, shard, input, channel_counts } = self;
        let graded = (!image.payloads.is_empty()).then(|| messages(image, input));
        if let (Rings::Bits32(ring), Some((channels, carried))) = (&*rings, &graded) {
            // Combines the bits of all magnitudes without a branch.
            let bits = |all: u32, payload: i32| all | (payload ^ payload >> 31) as u32;
            let all = channels.iter().fold(0, |all, spike| bits(all, spike.payload));
            let all = carried.iter().fold(all, |all, spike| bits(all, spike.payload));
            let is_large = |payload: i32| payload.unsigned_abs() > image.exact_up_to;
            // The spikes of a compartment without synapses, such as a read-out sum, may be large.
            let of_carried =
                |spike: &GradedSpike<CompartmentId>| is_large(spike.payload) && image.has_synapses[spike.id.index()];
            if all >= image.exact_up_to
                && (channels.iter().any(|spike| is_large(spike.payload)) || carried.iter().any(of_carried))
            {
                *rings = Rings::Bits64(ring.in_type());
            }
        }
        let within = (image, shard, *input);
        let (counts, binary) = (channel_counts, input.carried);
        match (rings, &graded) {
            (Rings::Bits16(ring), _) => {
                let spikes = Sent { channels: Counted { spikes: input.channels, counts }, carried: binary };
                narrow::run(Form { ring, state: &mut *state, within, spikes }, arch);
            }
            (Rings::Bits32(ring), None) => {
                let spikes = Sent { channels: Counted { spikes: input.channels, counts }, carried: binary };
                wide::run(Form { ring, state: &mut *state, within, spikes }, arch);
            }
            (Rings::Bits32(ring), Some((channels, carried))) => {
                let spikes = Sent { channels: Counted { spikes: channels, counts }, carried };
                graded::run(Form { ring, state: &mut *state, within, spikes }, arch);
            }
            (Rings::Bits64(ring), graded) => {
                let (channels, carried) = graded.as_ref().map_or((&[][..], &[][..]), |(a, b)| (a, b));
                let spikes = Sent { channels: Counted { spikes: channels, counts }, carried };
                large::run(Form { ring, state: &mut *state, within, spikes });
            }
        }
        if graded.is_some() {
            let emitted = state.spiked[..state.spiking].iter().map(|&lane| state.sent[lane as usize]);
            state.payloads.clear();
            state.payloads.extend(emitted);
        }
    }
}

/// A step for one type of sums and of spikes.
struct Form<'a, S, C, N> {
    ring: &'a mut DelayRing<S>,
    spikes: Sent<'a, C, N>,
    state: &'a mut CompartmentState,
    within: (&'a Image, &'a Shard, StepInput<'a>),
}

/// A step and its vectors, in the form that `pulp` runs. Everything below is inlined into one
/// function that is compiled for these vectors, unlike a closure.
struct With<F, V>(F, V);

impl<S, C: Spike, N: Spike> Form<'_, S, C, N>
where
    S: Sum + Accumulate<C::Payload> + Accumulate<N::Payload>,
{
    /// Runs the step with the widest vectors of the processor. Other vectors are not compiled,
    /// since each takes a third of this crate's compile time.
    #[inline(always)]
    fn run(self, arch: pulp::Arch) {
        match arch {
            #[cfg(target_arch = "x86_64")]
            pulp::Arch::V4(vectors) => vectors.vectorize(With(self, vectors)),
            #[cfg(target_arch = "x86_64")]
            pulp::Arch::V3(vectors) => vectors.vectorize(With(self, Portable)),
            #[cfg(target_arch = "x86_64")]
            _ => With(self, Portable).call(),
            #[cfg(not(target_arch = "x86_64"))]
            _ => arch.dispatch(With(self, Portable)),
        }
    }
}

impl<S, C: Spike, N: Spike, V: Vectors> NullaryFnOnce for With<Form<'_, S, C, N>, V>
where
    S: Sum + Accumulate<C::Payload> + Accumulate<N::Payload>,
{
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let With(Form { ring, spikes, state, within: (image, shard, input) }, vectors) = self;
        state.step(ring, image, shard, input, spikes, vectors);
    }
}

/// Declares a module for a form. Modules become separate pieces of machine code, which the compiler
/// makes in parallel.
macro_rules! form {
    ($name:ident, $sum:ty, $channel:ty, $compartment:ty) => {
        mod $name {
            use super::*;

            #[inline(never)]
            pub fn run(form: Form<'_, $sum, $channel, $compartment>, arch: pulp::Arch) {
                form.run(arch);
            }
        }
    };
}

form!(narrow, i16, ChannelId, CompartmentId);
form!(wide, i32, ChannelId, CompartmentId);
form!(graded, i32, GradedSpike<ChannelId>, GradedSpike<CompartmentId>);

mod large {
    use super::*;

    /// AVX2 has no vector multiplication of 64-bit numbers.
    #[inline(never)]
    pub fn run(form: Form<'_, i64, GradedSpike<ChannelId>, GradedSpike<CompartmentId>>) {
        With(form, Portable).call();
    }
}

/// Returns the messages of a step with their payloads.
fn messages(image: &Image, input: &StepInput) -> (Vec<GradedSpike<ChannelId>>, Vec<GradedSpike<CompartmentId>>) {
    let given = input.channels.iter().zip(input.channel_values);
    let channels = if image.channels_carry && input.channel_values.len() == input.channels.len() {
        given.map(|(&id, &payload)| GradedSpike { id, payload }).collect()
    } else {
        let mut given = input.channel_values.iter().copied();
        let graded = |&id: &ChannelId| {
            let given = given.next().unwrap_or(1);
            GradedSpike { id, payload: image.payloads[id.index()].unwrap_or(given) }
        };
        input.channels.iter().map(graded).collect()
    };
    let carried = input.carried.iter().zip(input.carried_payloads);
    (channels, carried.map(|(&id, &payload)| GradedSpike { id, payload }).collect())
}
