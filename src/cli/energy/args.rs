//! What is typed after `nsim energy`.

use std::path::PathBuf;

use clap::Args;

use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs::JobArgs;
use crate::cli::args::values::{Switch, one_of};
use crate::cost::Transport;
use crate::desc::published::baseline::Mode;
use crate::desc::published::scenario::Convention;
use crate::desc::published::workload::Accounting;
use crate::drive::decision::Rule;
use crate::energy::options::{DeploymentArg, HostArg, Watts};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim energy                                     the default model with the copies of its scenario, packed
  nsim energy --full                              with parts, intervals, sources and notes
  nsim energy --deployment paper --mode realtime  with the published numbers of cores, held to 1 ms steps
  nsim energy --convention published              energy as the VT-SNN paper computes it (power / timesteps)
  nsim energy --early-exit certain                what ending decided samples would save
  nsim energy --constants davies2018 --baseline   the other preset, and no baseline
  nsim energy --transport analytic                no queues: the longest route and the busiest link
  nsim energy --host none                         the chips alone, without what hands spikes over
  nsim energy --steps steps.csv                   a row a timestep: where spikes, time and energy go
  nsim energy --plot energy.pdf                   a chart of where the energy goes
  nsim energy --copies 1 --export-sanafe DIR      the same program for SANA-FE
  nsim energy --calibrate vtsnn-offline -o my.ron fit constants to a table, then use them: --constants my.ron
  nsim energy --calibrate vtsnn-realtime          a table that names nothing to fit is only compared
  nsim energy slip-tactile --input tactile=recording.npy --format json";

/// What is run, on what, and how it is priced: what `nsim energy` and `nsim report` have in common.
#[derive(Debug, Clone, Args)]
pub struct CostArgs {
    /// The network and the hardware.
    #[command(flatten)]
    pub job: JobArgs,
    /// What the network is shown.
    #[command(flatten)]
    pub input: InputArgs,
    /// Copies of the model on the target; figures are of one [default: those of --mapping, else those
    /// of the scenario that ships for the model, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub copies: Option<u32>,
    /// Numbers of cores used and powered: of this mapping, of the scenario that ships for the model, or of the file of a
    /// saved mapping or a scenario
    #[arg(help_heading = "Cost model", long, value_name = "packed|paper|FILE", default_value = "packed")]
    pub deployment: DeploymentArg,
    /// What hands spikes over and takes them back: the x86 core of each chip in use, or nothing, for the chips alone
    #[arg(help_heading = "Cost model", long, default_value = "board", value_parser = one_of(&HostArg::ALL, HostArg::name))]
    pub host: HostArg,
    /// As fast as possible, or held to the model's timestep
    #[arg(help_heading = "Cost model", long, default_value = "offline", value_parser = one_of(&Mode::ALL, Mode::name))]
    pub mode: Mode,
    /// Energy as power x latency, or as the VT-SNN paper computes it
    #[arg(help_heading = "Cost model", long, default_value = "physical", value_parser = one_of(&Convention::ALL, Convention::name))]
    pub convention: Convention,
    /// Other hardware to compare with: cpu (measured here), or a name of mapping/baselines; all when left out, none when
    /// given without a name
    #[arg(long, value_name = "NAME", num_args = 0.., value_delimiter = ',')]
    pub baseline: Option<Vec<String>>,
    /// Power of this machine's processor at idle and busy, where its counters cannot be read or are not to be
    #[arg(help_heading = "Cost model", long, value_name = "IDLE,BUSY")]
    pub cpu_watts: Option<Watts>,
    /// A command that passes the same samples through a GPU, to be timed with the board's power
    #[cfg(feature = "nvml")]
    #[arg(help_heading = "Cost model", long, value_name = "COMMAND")]
    pub gpu_command: Option<String>,
    /// Preset of constants: of those that the target names (its first when left out), or a file
    #[arg(help_heading = "Cost model", long, value_name = "PRESET|FILE")]
    pub constants: Option<String>,
    /// Which measurements the evidence for constants counts, where it has both: what NxSDK's profiler attributes, or what a
    /// board's rails draw above idle
    #[arg(help_heading = "Cost model", long, default_value = "profiler", value_parser = one_of(&Accounting::ALL, Accounting::name))]
    pub accounting: Accounting,
    /// How long messages take: every message through finite buffers, or the longest route and the busiest link
    #[arg(help_heading = "Cost model", long, default_value = Transport::default().name(), value_parser = one_of(&Transport::ALL, Transport::name))]
    pub transport: Transport,
    /// Whether the simulator skips work that cannot change anything; no figure depends on it
    #[arg(help_heading = "Cost model", long, default_value = "on")]
    pub skip: Switch,
    /// Say what ending a sample would save when an output leads by so many spikes, or when no other can overtake it
    #[arg(help_heading = "Cost model", long, value_name = "MARGIN|certain")]
    pub early_exit: Option<Rule>,
}

/// Options of `nsim energy`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct EnergyArgs {
    /// What is run and priced.
    #[command(flatten)]
    pub cost: CostArgs,
    /// A chart of where the energy goes
    #[arg(long, visible_alias = "svg", value_name = "FILE.svg|png|pdf")]
    pub plot: Option<PathBuf>,
    /// A row for each timestep of each sample: spikes by population, events, messages, hops, time and energy by part
    #[arg(long, value_name = "FILE.csv|npy|parquet")]
    pub steps: Option<PathBuf>,
    /// The mapped program, its chip and the first sample as files for SANA-FE
    #[arg(long, value_name = "DIR")]
    pub export_sanafe: Option<PathBuf>,
    /// Fit the constants that tables of measurements name to all of their cells, instead of a report; -o takes the preset
    #[arg(long, value_name = "TABLE", num_args = 1..)]
    pub calibrate: Vec<String>,
    /// The file that --calibrate writes
    #[arg(short, long, value_name = "FILE", requires = "calibrate")]
    pub output: Option<PathBuf>,
    /// Print the whole report, not its headline: parts, intervals, comparisons, sources, notes
    #[arg(long)]
    pub full: bool,
}
