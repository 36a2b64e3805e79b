//! Runs one sample and prints the cost of its events under a preset of constants.

use std::error::Error;

use nsim::compile::{Options, compile};
use nsim::cost::CostTable;
use nsim::cost::model::energy;
use nsim::files::target::{load_constants, load_target};
use nsim::import::model::load_model;
use nsim::ir::base::id::ChannelId;
use nsim::ir::spikes::Sample;
use nsim::machine::{Image, Machine, Settings};
use nsim::session::front::front;
use nsim::session::{SampleSettings, Session};

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let target = load_target("loihi1-chip")?;
    let compiled = compile(front(&load_model("vtsnn-slip")?)?, &target, &Options::default())?;
    let image = Image::new(&compiled.program, 1)?;
    let mut session = Session::new(Machine::new(&image, Settings { skip: true, per_step: false }), 1);

    let spikes: Vec<_> = (0..100).map(|step| (step, ChannelId(step % compiled.program.channels()))).collect();
    let keep = SampleSettings::new(compiled.program.output());
    session.run(&Sample::new(100, &spikes, None)?, &keep, ());

    // The machine counts; energy is a function of the counts and the constants.
    let table = CostTable::new(&load_constants("loihi1-evidence")?)?;
    let spent = energy(&session.engine_mut().take_activity(), &table);
    for (part, energy) in spent.parts() {
        println!("{part}: {:.3} nJ", energy.0 as f64 / 1e6);
    }
    println!("total: {:.3} nJ in 100 steps on {} cores", spent.total().0 as f64 / 1e6, compiled.placement.len());
    Ok(())
}
