//! Maps a shipped network onto a chip and prints the usage of each core.

use std::error::Error;

use nsim::compile::{CompileError, Options, compile};
use nsim::files::target::load_target;
use nsim::import::model::load_model;
use nsim::ir::resource::Resource;
use nsim::session::front::front;

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let network = load_model("vtsnn-slip")?;
    let target = load_target("loihi1-chip")?;
    match compile(front(&network)?, &target, &Options::default()) {
        Ok(compiled) => {
            for (core, used) in compiled.partition.usage().iter().enumerate() {
                let site = compiled.program.cores().as_slice()[core].site;
                println!("core {core} at tile ({}, {}): {} compartments", site.x, site.y, used[Resource::Compartments]);
            }
        }
        // Each reason names a core, a resource, the required amount and possible remedies.
        Err(CompileError::DoesNotFit(reasons)) => reasons.iter().for_each(|reason| println!("{reason}")),
        Err(error) => return Err(error.into()),
    }
    Ok(())
}
