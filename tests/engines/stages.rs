//! Each stage of the compiler as text: a written text reads back as the stage, and a changed text
//! is a valid stage or is refused.

use std::fmt::Debug;

use crate::common::random::{self, Draw};
use nsim::compile::{Options, load};
use nsim::files::mapping::pretty;
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::placement::Mesh;
use nsim::ir::quantised::Quantised;
use nsim::ir::spanned::parse;
use nsim::ir::spikes::Engine;
use nsim::quantise::prune::{Plan, prune};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

const NETWORKS: u64 = 1000;

fn read<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    parse(&SourceText::new("stage.ron", text), "stage.syntax").map_err(|problem| problem.message)
}

/// The text of a stage; it reads back as the stage.
fn text<T: Serialize + DeserializeOwned + PartialEq + Debug>(stage: &T, depth: usize) -> String {
    let text = pretty(stage, depth).unwrap();
    assert!(read::<T>(&text).unwrap() == *stage, "{text}");
    text
}

/// The text with one of its digits replaced by a number.
fn changed(text: &str, draw: &mut Draw) -> String {
    let digits: Vec<usize> = text.match_indices(|c: char| c.is_ascii_digit()).map(|(at, _)| at).collect();
    let at = digits[draw.from(0, digits.len() as i64 - 1) as usize];
    let number = draw.one_of(&["0", "1", "7", "-1", "64", "65535", "4294967295", "99999999999"]);
    format!("{}{number}{}", &text[..at], &text[at + 1..])
}

#[test]
fn the_text_of_each_stage_reads_back_as_the_stage() {
    let target = load_target("loihi1-chip").unwrap();
    (0..NETWORKS).into_par_iter().for_each(|seed| {
        let network = random::network(seed);
        let file = random::mapping(&network, &Mesh::for_target(&target), seed);
        if seed % 4 == 0 {
            text(&prune(&network, &Plan::fixed()).unwrap(), 3);
            text(&random::joined(seed), 3);
        }
        let written = text(&network, 3);
        let Ok(compiled) = load(network.clone(), &target, &Options::default(), &file) else { return };
        text(&compiled.partition, 2);
        text(&compiled.placement, 2);
        let program = text(&*compiled.program, 5);
        if seed % 10 > 0 {
            return;
        }
        // An accepted changed text can be run, if it takes little memory.
        let draw = &mut Draw::new(seed);
        for _ in 0..10 {
            let other = read::<Quantised>(&changed(&written, draw)).ok();
            if let Some(other) =
                other.filter(|it| it.channels().max(it.compartments()) < 10_000 && it.synapses() < 1_000_000)
            {
                let mut golden = Golden::new(&other);
                golden.begin(1);
                golden.step((&[]).into());
            }
            let _ = read::<nsim::ir::program::Program>(&changed(&program, draw));
            let _ = read::<nsim::ir::partition::Partition>(&changed(&pretty(&compiled.partition, 2).unwrap(), draw));
            let _ = read::<nsim::ir::placement::Placement>(&changed(&pretty(&compiled.placement, 2).unwrap(), draw));
        }
    });
}
