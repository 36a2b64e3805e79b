//! What a cache keeps of a mapping, and under which key.
//!
//! Input: what is compiled, for what and how; a mapping. Output: a key that two compilations share
//! only if they are of the same content, options and program; the compartments and the place of
//! each core as bytes, and back. Everything else is computed again from these, verified and
//! checked, so that a mapping from a cache is the one that compiling afresh gives, and no byte need
//! be believed.
//!
//! Errors: bytes that are cut, changed or of another network are no mapping; a caller then
//! compiles.

use std::hash::{Hash, Hasher};

use sha2::{Digest, Sha256};

use crate::mapping::Mapping;
use crate::place;
use crate::stages::{Front, Placed};
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec};
use nsim_ir::dealt::Share;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::partition::Partition;
use nsim_ir::placement::{Placement, Site};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Parts, Population, Projection, Quantised, Units};
use nsim_partition::error::CompileError;
use nsim_partition::form::Form;
use nsim_partition::options::{Effort, Options};
use nsim_partition::strategy::members::Members;

/// Begins every entry; another layout of the bytes begins otherwise.
const MAGIC: &[u8; 8] = b"nsim-m01";
/// Bytes of the digest at the end.
const DIGEST: usize = 32;
/// Synapses of a network below which mapping for few cores takes no longer than looking for an
/// entry.
const SMALL: u64 = 20_000;

/// The compartments of each core and its site.
type OnSites = (Members, IdVec<CoreId, Site>);

/// A digest that takes what can be hashed.
struct Key(Sha256);

impl Hasher for Key {
    fn finish(&self) -> u64 {
        0
    }

    fn write(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }
}

impl Key {
    /// Adds a text and its length, so that no two sequences of texts are the same.
    fn text(&mut self, text: &str) {
        text.len().hash(self);
        self.write(text.as_bytes());
    }
}

/// The key of a mapping, or `None` where none is kept: mappings of small networks, of kernels and
/// by the clock. `build` stands for the program that compiles.
#[must_use]
pub fn key(
    front: &Front,
    target: &Target,
    options: &Options,
    rates: &Rates,
    form: Form,
    build: &str,
) -> Option<String> {
    let one = front.quantised();
    let by_the_clock = !matches!(options.effort, Effort::Work(_));
    if form == Form::Symbolic || by_the_clock || one.synapses() < SMALL || one.pruned().is_some() || options.copies > 1
    {
        return None;
    }
    let mut key = Key(Sha256::new());
    key.write(MAGIC);
    key.text(build);
    // Every rank makes the same mapping.
    key.text(&format!("{target:?} {:?}", Options { share: Share::ALL, ..*options }));
    match rates {
        Rates::Assumed(rate) => rate.hash(&mut key),
        Rates::Profile { of, channels } => (of, channels).hash(&mut key),
    }
    network(one, &mut key);
    Some(key.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

fn network(network: &Quantised, key: &mut Key) {
    let parts = network.parts();
    let Parts { name, decision, semantics, threshold, reset, gathers, .. } = parts;
    key.text(&format!("{name} {decision:?} {semantics:?} {threshold:?} {reset:?} {gathers}"));
    parts.output.0.hash(key);
    parts.populations.iter().for_each(|one| population(one, key));
    parts.projections.iter().for_each(|one| projection(one, key));
}

fn population(population: &Population, key: &mut Key) {
    let Population { name, shape, units, payload } = population;
    key.text(&format!("{name} {shape:?} {payload:?}"));
    match units {
        Units::Input(first) => first.0.hash(key),
        Units::Compartments { first, neurons, start_step } => {
            (first.0, start_step).hash(key);
            (0..shape.len()).for_each(|index| neurons.get(index).hash(key));
        }
    }
}

fn projection(projection: &Projection, key: &mut Key) {
    let Projection { name, source, target, format, delay, connectivity } = projection;
    key.text(&format!("{name} {format:?} {delay:?}"));
    (source.0, target.0).hash(key);
    match connectivity {
        Connectivity::Dense { targets, weights } => (0u8, targets, &weights[..]).hash(key),
        Connectivity::Sparse { first, targets, weights } => (1u8, &first[..], &targets[..], &weights[..]).hash(key),
        Connectivity::Conv2d { window, kernel } => {
            key.text(&format!("{window:?}"));
            (2u8, &kernel[..]).hash(key);
        }
        Connectivity::SumPool2d { .. } | Connectivity::Random { .. } => key.text(&format!("{connectivity:?}")),
    }
}

/// The compartments and the place of each core.
#[must_use]
pub fn to_bytes(mapping: &Mapping) -> Vec<u8> {
    places_to_bytes(&mapping.partition, &mapping.placement, mapping.placed)
}

/// The same of a partition and a placement of this name.
#[must_use]
pub fn places_to_bytes(partition: &Partition, placement: &Placement, placed: &'static str) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.push(u8::from(placed == place::ANNEALED));
    let mut put = |value: u32| bytes.extend(value.to_le_bytes());
    put(partition.cores() as u32);
    for (core, held) in partition.members().enumerate() {
        let Site { chip, x, y, core } = placement.site(core);
        [chip, x, y, core, held.len() as u32].into_iter().for_each(&mut put);
        held.iter().for_each(|id| put(id.0));
    }
    let digest = Sha256::digest(&bytes);
    bytes.extend(digest);
    bytes
}

/// Compartments and places from bytes, with the name of the placement; `None` when they are
/// damaged.
fn from_bytes(bytes: &[u8]) -> Option<(OnSites, &'static str)> {
    let (content, digest) = bytes.split_at_checked(bytes.len().checked_sub(DIGEST)?)?;
    let (magic, rest) = content.split_at_checked(MAGIC.len() + 1)?;
    if Sha256::digest(content)[..] != *digest || magic[..MAGIC.len()] != *MAGIC {
        return None;
    }
    let mut words = rest.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap_or_default()));
    let (mut members, mut sites) = (Vec::new(), Vec::new());
    for _ in 0..words.next()? {
        let [chip, x, y, core, held] = [words.next()?, words.next()?, words.next()?, words.next()?, words.next()?];
        let held: Vec<CompartmentId> = words.by_ref().take(held as usize).map(CompartmentId).collect();
        sites.push(Site { chip, x, y, core });
        members.push(held);
    }
    let placed = if magic[MAGIC.len()] == 1 { place::ANNEALED } else { place::SEQUENTIAL };
    words.next().is_none().then(|| ((members.into(), sites.into()), placed))
}

/// The mapping that bytes give for a network, verified and checked as any other.
///
/// # Errors
/// [`CompileError`] when they do not give one.
pub fn from_kept(
    front: Front,
    target: &Target,
    options: &Options,
    rates: &Rates,
    bytes: &[u8],
) -> Result<Mapping, CompileError> {
    let placed = placed_from_kept(front, target, options, rates, bytes)?;
    placed.emit(target, options)?.check(target)
}

/// A network on the places that bytes give for it.
///
/// # Errors
/// [`CompileError`] when they do not give any.
pub fn placed_from_kept(
    front: Front,
    target: &Target,
    options: &Options,
    rates: &Rates,
    bytes: &[u8],
) -> Result<Placed, CompileError> {
    let damaged = || CompileError::fault("the entry is damaged");
    let (on_sites, placed) = from_bytes(bytes).ok_or_else(damaged)?;
    front.place_on(target, options, rates, on_sites, placed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEFAULT_RATE, Objective, map};
    use nsim_ir::base::rng;
    use nsim_ir::resource::Resource;
    use nsim_testing::{Builder, limits, random_network, target};

    fn large(seed: u64) -> Quantised {
        let mut net = Builder::new();
        let (a, b) = (net.input("a", 400), net.loihi("b", 400));
        net.random(a, b, 30, seed);
        net.random(b, b, 30, seed + 1);
        net.build()
    }

    #[test]
    fn what_is_kept_gives_the_mapping_that_compiling_gives() {
        for seed in 0..6 {
            let board = target(2, 2, limits().with(Resource::Compartments, 60));
            let (options, rates) = (Options { seed, ..Options::default() }, Rates::assumed(DEFAULT_RATE));
            let fresh = map(large(seed).into(), &board, &options, &rates, Form::Written).unwrap();
            let bytes = to_bytes(&fresh);
            let kept = from_kept(large(seed).into(), &board, &options, &rates, &bytes).unwrap();
            assert_eq!(
                (&kept.partition, &kept.placement, kept.placed),
                (&fresh.partition, &fresh.placement, fresh.placed)
            );
            assert_eq!((kept.checked, &kept.rates, kept.options), (fresh.checked, &fresh.rates, fresh.options));
            let stages = |mapping: &Mapping| mapping.seconds.iter().map(|(stage, _)| *stage).collect::<Vec<_>>();
            assert_eq!(stages(&kept), stages(&fresh));
            let program = |mapping: Mapping| mapping.into_compiled().unwrap().program;
            assert_eq!(program(kept), program(fresh));
            for at in 0..60 {
                let mut damaged = bytes.clone();
                let byte = rng::below(bytes.len() as u64, seed, at, 0) as usize;
                match at % 3 {
                    0 => damaged[byte] ^= 1 << (at % 8),
                    1 => damaged.truncate(byte),
                    _ => damaged.push(0),
                }
                assert!(from_kept(large(seed).into(), &board, &options, &rates, &damaged).is_err());
            }
            let other = from_kept(random_network(seed).into(), &board, &options, &rates, &bytes);
            assert!(other.is_err(), "of another network");
        }
    }

    #[test]
    fn whatever_changes_a_mapping_changes_the_key() {
        let (board, options, rates) = (target(2, 2, limits()), Options::default(), Rates::assumed(DEFAULT_RATE));
        let of = |network: Quantised, board: &Target, options: &Options, rates: &Rates, build| {
            key(&network.into(), board, options, rates, Form::Written, build)
        };
        let keys = [
            of(large(1), &board, &options, &rates, "1"),
            of(large(2), &board, &options, &rates, "1"),
            of(large(1), &target(2, 1, limits()), &options, &rates, "1"),
            of(large(1), &target(2, 2, limits().with(Resource::AxonsOut, 4_000)), &options, &rates, "1"),
            of(large(1), &board, &Options { seed: 1, ..options }, &rates, "1"),
            of(large(1), &board, &Options { objective: Objective::Latency, ..options }, &rates, "1"),
            of(large(1), &board, &Options { effort: Effort::Work(0), ..options }, &rates, "1"),
            of(large(1), &board, &options, &Rates::assumed(0.5), "1"),
            of(large(1), &board, &options, &rates, "2"),
        ];
        for (n, key) in keys.iter().enumerate() {
            assert!(key.is_some() && !keys[..n].contains(key), "{n}");
        }
        assert_eq!(keys[0], of(large(1), &board, &options, &rates, "1"));
        assert_eq!(of(random_network(1), &board, &options, &rates, "1"), None, "too small");
        assert_eq!(of(large(1), &board, &Options { effort: Effort::within_ms(9), ..options }, &rates, "1"), None);
    }
}
