//! Programs of several copies, written and proven.

use crate::emit::route::route;
use crate::{Options, compile};
use nsim_check::equivalence::check_copies;
use nsim_ir::program::Program;
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
        let alone = route(network, &mapped.partition, (&mapped.placement, None), 1, limits).unwrap();
        assert_eq!(without_classes(&mapped.program), without_classes(&alone), "seed {seed}");
        let alone = Program::new(without_classes(&alone)).unwrap();
        assert_eq!(check_copies(network, &alone, copies), Ok(0), "seed {seed}: cores without a class prove nothing");
        proven += check_copies(network, &mapped.program, copies).unwrap();
    }
    assert!(proven > 60, "{proven} cores were proven from others");
}
