//! Arguments of `nsim energy`.

use std::path::PathBuf;

use clap::Args;

use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs::JobArgs;
use crate::cli::args::values::{Switch, one_of};
use nsim_cost::job::{Accounting, Convention, Mode};
use nsim_cost::{Host, Streams, Transport};
use nsim_energy::options::Watts;
use nsim_report::charts::picture::FILE;
use nsim_session::decision::Rule;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim energy                                     the default model, one copy on one chip
  nsim energy --full                              with parts, intervals, sources and notes
  nsim energy --deployment paper --mode realtime  the measured job of the model, held to 1 ms steps
  nsim energy --copies 32 --deployment packed     32 copies on as few cores as they fit
  nsim energy --accounting rails                  the reading of a power meter on the board
  nsim energy --convention published              energy as the VT-SNN paper computes it (power / timesteps)
  nsim energy --early-exit certain                savings from ending decided samples
  nsim energy --constants davies2018 --baseline   other constants, and no baseline
  nsim energy --set constants.injection_time=0.4us  one constant changed
  nsim energy --transport analytic                no queues: the longest route and the busiest link
  nsim energy --host none                         the neuron cores alone, without x86 cores
  nsim energy --steps steps.csv                   a row per timestep: spikes, time and energy
  nsim energy --plot energy.svg                   power, time and energy of all hardware side by side
  nsim energy --export-sanafe DIR                 the same program for SANA-FE
  nsim energy slip-tactile --input tactile=recording.npy --format json";

/// Job, input and cost model: arguments of `nsim energy`, `nsim report` and `nsim plot`.
#[derive(Debug, Clone, Args)]
pub struct CostArgs {
    #[command(flatten)]
    pub job: JobArgs,
    #[command(flatten)]
    pub input: InputArgs,
    /// Copies of the model on the target; figures are of one [default: those of --mapping, else 1;
    /// those of the measured job with --deployment paper]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub copies: Option<u32>,
    /// Placement of copies: each on chips of its own and then more on each chip (spread), or on as
    /// few cores as they fit (packed); as in the measured job of the model (paper); numbers of
    /// cores, chips and x86 cores; or the file of a saved mapping or a scenario [default: spread]
    #[arg(help_heading = "Cost model", long, value_name = "spread|packed|paper|FILE|CORES,CHIPS,X86")]
    pub deployment: Option<String>,
    /// Source of input spikes: a computer through an x86 core of each chip, that x86 core's memory,
    /// or nothing, for the neuron cores alone [default: stream where the chip has x86 cores]
    #[arg(help_heading = "Cost model", long, value_parser = one_of(&Host::ALL, Host::name))]
    pub host: Option<Host>,
    /// Input streams of a chip: one that its copies share, or one for each copy
    #[arg(
        help_heading = "Cost model", long, default_value = "one",
        value_parser = one_of(&Streams::ALL, Streams::name)
    )]
    pub streams: Streams,
    /// Words of 32 bits of each core that an x86 core sets to zero after a sample, such as 10496
    #[arg(
        help_heading = "Cost model", long, value_name = "WORDS", default_value_t = 0,
        value_parser = clap::value_parser!(u64).range(..=1 << 20)
    )]
    pub reset_words: u64,
    /// As fast as possible, or held to the model's timestep
    #[arg(help_heading = "Cost model", long, default_value = "offline", value_parser = one_of(&Mode::ALL, Mode::name))]
    pub mode: Mode,
    /// Energy as power x latency, or as the VT-SNN paper computes it
    #[arg(
        help_heading = "Cost model", long, default_value = "physical",
        value_parser = one_of(&Convention::ALL, Convention::name)
    )]
    pub convention: Convention,
    /// Other hardware to compare with: cpu (measured here), a GPU measured for this model, or
    /// gpu-roofline (modelled from its peak rates); the first two when omitted, none when given
    /// without a name
    #[arg(long, value_name = "NAME", num_args = 0.., value_delimiter = ',')]
    pub baseline: Option<Vec<String>>,
    /// Power of this machine's processor at idle and busy, instead of its counters
    #[arg(help_heading = "Cost model", long, value_name = "IDLE,BUSY")]
    pub cpu_watts: Option<Watts>,
    /// A command that passes the same samples through a GPU, to be timed with the board's power
    #[cfg(feature = "nvml")]
    #[arg(help_heading = "Cost model", long, value_name = "COMMAND")]
    pub gpu_command: Option<String>,
    /// Preset of constants: one that the target names (its first when omitted), or a file
    #[arg(help_heading = "Cost model", long, value_name = "PRESET|FILE")]
    pub constants: Option<String>,
    /// Power to report: the job's by Intel's profiler, the board's rails by a power meter, or the
    /// whole unit's with its host side
    #[arg(
        help_heading = "Cost model", long, default_value = "profiler",
        value_parser = one_of(&Accounting::ALL, Accounting::name)
    )]
    pub accounting: Accounting,
    /// Model of message times: every message through finite buffers, or the longest route and the
    /// busiest link
    #[arg(
        help_heading = "Cost model", long, default_value = Transport::default().name(),
        value_parser = one_of(&Transport::ALL, Transport::name)
    )]
    pub transport: Transport,
    /// Whether the simulator skips work that cannot change anything; no figure depends on it
    #[arg(help_heading = "Cost model", long, default_value = "on")]
    pub skip: Switch,
    /// Show the savings of ending a sample when an output leads by this many spikes, or when no
    /// other can overtake it
    #[arg(help_heading = "Cost model", long, value_name = "MARGIN|certain")]
    pub early_exit: Option<Rule>,
}

/// Options of `nsim energy`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct EnergyArgs {
    #[command(flatten)]
    pub cost: CostArgs,
    /// A chart of power, time and energy of all hardware
    #[arg(long, visible_alias = "svg", value_name = FILE)]
    pub plot: Option<PathBuf>,
    /// A row for each timestep of each sample: spikes by population, events, messages, hops, time
    /// and energy by part
    #[arg(long, value_name = "FILE.csv|npy")]
    pub steps: Option<PathBuf>,
    /// The mapped program, its chip and the first sample as files for SANA-FE
    #[arg(long, value_name = "DIR")]
    pub export_sanafe: Option<PathBuf>,
    /// Print the whole report, not its headline: parts, intervals, comparisons, sources, notes
    #[arg(long)]
    pub full: bool,
}
