//! Several copies of a network that share nothing.
//!
//! Input: a network. Output: a network with n copies of every population and projection, copy after
//! copy. Populations of copy k are named `name@k` from k = 1 on. Input channels are copied too, so
//! that each copy has its own input axons. Copies share weights in memory, but not on a chip.

use std::sync::Arc;

use nsim_ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim_ir::graph::MOST_UNITS;
use nsim_ir::learning::Plastic;
use nsim_ir::quantised::{Child, Inconsistent, Parts, Projection, Quantised, Units};

/// Returns `n` copies of a network. The output population belongs to copy 0.
///
/// # Errors
/// [`Inconsistent`] when `n` is 0, when a network may not have as many units, or when a name has
/// the form of a copy's name.
pub fn copies(network: &Quantised, n: u32) -> Result<Quantised, Inconsistent> {
    let units = u64::from(network.channels()).max(u64::from(network.compartments()));
    if n == 0 || units * u64::from(n) > MOST_UNITS {
        let what = format!("{n} copies of {units} channels or compartments are not between 1 and {MOST_UNITS}");
        return Err(Inconsistent(what));
    }
    if n == 1 {
        return Ok(network.clone());
    }
    let one = network.parts();
    if let Some(taken) = one.populations.iter().find(|p| is_copy_name(&p.name)) {
        let what = format!("the name of population {} is also the name of a copy of another; rename it", taken.name);
        return Err(Inconsistent(what));
    }
    let per_copy = one.populations.len() as u32;
    let mut parts = Parts {
        populations: Default::default(),
        projections: Default::default(),
        children: Vec::new(),
        rules: one.rules.clone(),
        name: one.name.clone(),
        classes: one.classes.clone(),
        notes: one.notes.clone(),
        warnings: one.warnings.clone(),
        ..*one
    };
    for k in 0..n {
        for population in &one.populations {
            let mut copy = population.clone();
            if k > 0 {
                copy.name = format!("{}@{k}", population.name);
            }
            match &mut copy.units {
                Units::Input(first) => *first = ChannelId(first.0 + k * network.channels()),
                Units::Compartments { first, .. } => *first = CompartmentId(first.0 + k * network.compartments()),
            }
            parts.populations.push(copy);
        }
        let of_copy = |id: PopulationId| PopulationId(id.0 + k * per_copy);
        for projection in &one.projections {
            let [source, target] = [projection.source, projection.target].map(of_copy);
            let signals = |plastic: &Arc<Plastic>| {
                let signals = plastic.signals.map(|signal| signal.map(of_copy));
                let reward = plastic.reward.map(of_copy);
                Arc::new(Plastic { signals, reward, ..Plastic::clone(plastic) })
            };
            let plastic = projection.plastic.as_ref().map(signals);
            parts.projections.push(Projection { source, target, plastic, ..projection.clone() });
        }
        for child in &one.children {
            let [population, parent] = [child.population, child.parent].map(of_copy);
            parts.children.push(Child { population, parent, ..*child });
        }
    }
    Quantised::new(parts)?.with_record(network.pruned().cloned())
}

fn is_copy_name(name: &str) -> bool {
    name.rsplit_once('@').is_some_and(|(_, k)| !k.is_empty() && k.bytes().all(|b| b.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::{Builder, random_network};

    #[test]
    fn copies_share_nothing_and_say_the_same() {
        let one = random_network(7);
        let three = copies(&one, 3).unwrap();
        assert_eq!(three.channels(), 3 * one.channels());
        assert_eq!((three.compartments(), three.synapses()), (3 * one.compartments(), 3 * one.synapses()));
        let per_copy = one.populations().len() as u32;
        for (id, projection) in three.projections().enumerate() {
            let k = id.0 / one.projections().len() as u32;
            assert_eq!((projection.source.0 / per_copy, projection.target.0 / per_copy), (k, k));
        }
        let names: Vec<&str> = three.populations().iter().map(|p| p.name.as_str()).collect();
        assert!(names.contains(&"in0") && names.contains(&"in0@2"), "{names:?}");
    }

    #[test]
    fn a_name_that_a_copy_would_take_is_refused() {
        let mut builder = Builder::new();
        let input = builder.input("a", 1);
        let output = builder.loihi("b@1", 1);
        builder.dense(input, output, |_, _| 2);
        let network = builder.build();
        assert!(copies(&network, 2).unwrap_err().0.contains("b@1"));
        assert!(copies(&network, 0).is_err() && copies(&network, u32::MAX).is_err());
        assert!(copies(&network, 1).is_ok());
    }
}
