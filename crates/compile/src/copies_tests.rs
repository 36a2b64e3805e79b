//! Programs of several copies, written and proven.

use crate::emit::route::route;
use crate::{Options, compile};
use nsim_check::equivalence::{check, check_copies};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::program::{Parts, Program};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::resource::Resource;
use nsim_testing::{limits, random_network, target, without_classes};

#[test]
fn copies_are_written_as_each_by_itself_and_proven_from_one_of_each_kind() {
    let mut proven = 0;
    for seed in 0..24 {
        let copies = [2, 7, 31][seed as usize % 3];
        let most = 20 + seed as u32 % 60;
        let board = target(3, 3, limits().with(Resource::Compartments, most));
        let options = Options { copies, ..Options::default() };
        let Ok(mapped) = compile(random_network(seed), &board, &options) else { continue };
        let (network, limits) = (&mapped.quantised, board.limits());
        let alone = route(network, &mapped.partition, &mapped.placement, (1, None), limits).unwrap();
        assert_eq!(without_classes(&mapped.program), without_classes(&alone), "seed {seed}");
        let alone = Program::new(without_classes(&alone)).unwrap();
        assert_eq!(check_copies(network, &alone, copies), Ok(0), "seed {seed}: cores without a class prove nothing");
        proven += check_copies(network, &mapped.program, copies).unwrap();
    }
    assert!(proven > 60, "{proven} cores were proven from others");
}

#[test]
fn a_change_of_one_copy_is_found() {
    let board = target(3, 3, limits());
    for seed in 0..12 {
        let Ok(mapped) = compile(random_network(seed), &board, &Options { copies: 9, ..Options::default() }) else {
            continue;
        };
        let network = &mapped.quantised;
        let seat = mapped.program.seats()[CompartmentId(5 * mapped.one.compartments())];
        let mut changes: Vec<Parts> = Vec::new();
        let mut change = |f: &dyn Fn(&mut Parts) -> Option<()>| {
            let mut parts = mapped.program.parts().clone();
            if f(&mut parts).is_some() {
                changes.push(parts);
            }
        };
        change(&|parts| {
            let weight = &mut parts.class_mut(seat.core).inputs.lists.items_mut().first_mut()?.weight;
            *weight += if *weight > 0 { -2 } else { 2 };
            Some(())
        });
        change(&|parts| {
            parts.class_mut(seat.core).compartments[usize::from(seat.slot)].start_step += 1;
            Some(())
        });
        change(&|parts| {
            // A core of the sixth copy is of another class.
            let class = parts.cores[seat.core].class;
            let other = parts.cores.iter().find(|image| image.class != class)?.class;
            parts.cores[seat.core].class = other;
            (parts.classes[class] != parts.classes[other]).then_some(())
        });
        change(&|parts| {
            // Two compartments of the sixth copy change places, with the tables as they were.
            let [a, b] = [0, 1].map(|slot| parts.cores[seat.core].ids.get(slot).copied());
            let (a, b) = (a?, b?);
            parts.cores[seat.core].ids.swap(0, 1);
            (parts.seats[a].slot, parts.seats[b].slot) = (1, 0);
            let class = parts.class_of(seat.core);
            let into = |slot| class.inputs.synapses().filter(|s| s.slot == slot).map(|s| s.weight).collect::<Vec<_>>();
            (into(0) != into(1)).then_some(())
        });
        change(&|parts| {
            // Two messages of the sixth copy's channels to the same core change places.
            let of_copy = parts.channels.len() / 9;
            let messages: Vec<usize> =
                (5 * of_copy..6 * of_copy).filter(|&channel| !parts.channels.get(channel).is_empty()).collect();
            let (&a, &b) = (messages.first()?, messages.get(1)?);
            let (one, other) = (parts.channels.get(a)[0], parts.channels.get(b)[0]);
            (parts.channels.get_mut(a)[0], parts.channels.get_mut(b)[0]) = (other, one);
            (network_differs(network, a as u32, b as u32)).then_some(())
        });
        for parts in changes {
            let Ok(program) = Program::new(parts) else { continue };
            assert!(check(network, &program).is_err(), "seed {seed}");
            assert!(check_copies(network, &program, 9).is_err(), "seed {seed}");
        }
    }
}

/// Whether two channels reach other synapses.
fn network_differs(network: &Quantised, a: u32, b: u32) -> bool {
    let synapses = |channel: u32| {
        let mut found = Vec::new();
        for (id, population) in network.populations().enumerate() {
            let Units::Input(first) = population.units else { continue };
            let Some(index) = channel.checked_sub(first.0).filter(|&i| i < population.shape.len()) else {
                continue;
            };
            for (_, projection, target) in network.targets_of(id) {
                projection.connectivity.for_each_from(index, |t, weight| {
                    found.push((target.0 + t, weight, projection.delay, projection.format.bits));
                });
            }
        }
        found.sort_unstable();
        found
    };
    synapses(a) != synapses(b)
}
