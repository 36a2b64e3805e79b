//! Runs one sample through the machine and prints the output spikes.

use std::error::Error;

use nsim::compile::{Options, compile};
use nsim::files::target::load_target;
use nsim::import::model::load_model;
use nsim::ir::base::id::ChannelId;
use nsim::ir::spikes::Sample;
use nsim::machine::{Image, Machine, Settings};
use nsim::session::front::front;
use nsim::session::{SampleSettings, Session};

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let compiled = compile(front(&load_model("vtsnn-slip")?)?, &load_target("loihi1-chip")?, &Options::default())?;
    let program = &compiled.program;

    // A hundred timesteps; in every third step another tenth of the channels spikes.
    let spikes: Vec<(u32, ChannelId)> = (0..100)
        .step_by(3)
        .flat_map(|step| (step % 10..program.channels()).step_by(10).map(move |channel| (step, ChannelId(channel))))
        .collect();
    let sample = Sample::new(100, &spikes, None)?;

    let image = Image::new(program, 1)?;
    let mut session = Session::new(Machine::new(&image, Settings { skip: true, per_step: false }), 1);
    let outcome = session.run(&sample, &SampleSettings::new(program.output()), ());

    println!("class {:?}, spikes of each output {:?}", outcome.class(), outcome.counts);
    println!("{} synaptic events in {} steps", outcome.totals.synaptic_events, outcome.steps);
    Ok(())
}
