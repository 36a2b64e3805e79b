//! A timestep of a shard, in the form of its sums and of what its spikes carry.
//!
//! Input: the state of a shard of an [`Image`], and the spikes to deliver. Output: the state after
//! the step, with the next spikes and what each carries. The form is the narrowest whose sums are
//! exact; once a large graded spike arrives, the sums of the shard have 64 bits. Each form is
//! compiled for the widest vectors of the processor.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::delay_ring::DelayRing;
use crate::layout::image::Image;
use crate::layout::shard::Shard;
use crate::update::kernel::{Portable, Sum, Vectors};
use crate::update::state::{CompartmentState, Rings, ShardState, StepInput};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id};
use nsim_ir::spikes::{GradedSpike, Spike};
use pulp::NullaryFnOnce;

/// A step of a shard.
pub(crate) struct Step<'a> {
    pub state: &'a mut ShardState,
    pub image: &'a Image,
    pub shard: &'a Shard,
    pub input: &'a StepInput<'a>,
    /// Spikes of each channel, which delivery counts unless this is empty.
    pub channel_counts: &'a mut [u32],
}

impl Step<'_> {
    /// Runs it in the form of its sums and of what its spikes carry.
    pub fn run(self, arch: pulp::Arch) {
        let Step { state: ShardState { state, rings }, image, shard, input, channel_counts } = self;
        let graded = (!image.payloads.is_empty()).then(|| messages(image, input));
        if let (Rings::Bits32(ring), Some((channels, carried))) = (&*rings, &graded) {
            // The bits of all magnitudes together are found without a branch.
            let bits = |all: u32, payload: i32| all | (payload ^ payload >> 31) as u32;
            let all = channels.iter().fold(0, |all, spike| bits(all, spike.payload));
            let all = carried.iter().fold(all, |all, spike| bits(all, spike.payload));
            let is_large = |payload: i32| payload.unsigned_abs() > image.exact_up_to;
            // What reaches nothing, such as a sum that is read out, may be large.
            let of_carried =
                |spike: &GradedSpike<CompartmentId>| is_large(spike.payload) && image.has_synapses[spike.id.index()];
            if all >= image.exact_up_to
                && (channels.iter().any(|spike| is_large(spike.payload)) || carried.iter().any(of_carried))
            {
                *rings = Rings::Bits64(ring.in_type());
            }
        }
        let binary = (input.channels, &mut *channel_counts, input.carried);
        let within = (image, shard, *input);
        match (rings, &graded) {
            (Rings::Bits16(ring), _) => narrow::run(Form { ring, state: &mut *state, within, spikes: binary }, arch),
            (Rings::Bits32(ring), None) => wide::run(Form { ring, state: &mut *state, within, spikes: binary }, arch),
            (Rings::Bits32(ring), Some((channels, carried))) => {
                let spikes = (channels.as_slice(), channel_counts, carried.as_slice());
                graded::run(Form { ring, state: &mut *state, within, spikes }, arch);
            }
            (Rings::Bits64(ring), graded) => {
                let (channels, carried) = graded.as_ref().map_or((&[][..], &[][..]), |(a, b)| (a, b));
                let form = Form { ring, state: &mut *state, within, spikes: (channels, channel_counts, carried) };
                large::run(form);
            }
        }
        if graded.is_some() {
            let emitted = state.spiked[..state.spiking].iter().map(|&lane| state.sent[lane as usize]);
            state.payloads.clear();
            state.payloads.extend(emitted);
        }
    }
}

/// A step with sums of one type and spikes that carry one type.
struct Form<'a, S, C, N> {
    ring: &'a mut DelayRing<S>,
    /// Those of channels, how often each channel spiked, those of compartments.
    spikes: (&'a [C], &'a mut [u32], &'a [N]),
    state: &'a mut CompartmentState,
    within: (&'a Image, &'a Shard, StepInput<'a>),
}

/// A step and its vectors, as `pulp` runs it: everything below is inlined into one function that is
/// compiled for them. (A closure would not be.)
struct With<F, V>(F, V);

impl<S, C: Spike, N: Spike> Form<'_, S, C, N>
where
    S: Sum + Accumulate<C::Payload> + Accumulate<N::Payload>,
{
    /// Runs it with the widest vectors of the processor. Vectors of others are not compiled: each
    /// is a third of the time that this crate takes to compile.
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

/// Declares a module for a form. The compiler makes one piece of machine code of a module, and the
/// pieces at the same time.
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

    /// No vectors of AVX2 multiply numbers of 64 bits.
    #[inline(never)]
    pub fn run(form: Form<'_, i64, GradedSpike<ChannelId>, GradedSpike<CompartmentId>>) {
        With(form, Portable).call();
    }
}

/// The messages of a step and what each carries.
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
