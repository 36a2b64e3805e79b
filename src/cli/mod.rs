//! The command line. A subcommand has a file, which makes a validated job of its arguments, calls
//! the library, and writes the result.
//!
//! stdout carries the result, stderr everything else. Exit status: 0 done; 1 the answer is no; 2
//! wrong usage; 3 an input cannot be read or is not supported; 4 an internal error; 130 and 143
//! ended by SIGINT, SIGTERM.

mod agree;
pub mod args;
mod bench;
mod compare;
mod context;
mod convert;
mod diagnostics;
mod energy;
mod export;
mod import;
mod inspect;
mod map;
mod output;
mod plot;
mod probes;
mod process;
mod report;
mod run;
mod scene;
mod stress;
mod sweep;
mod train;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::cli::context::{Answer, Context, Format};
use crate::cli::process::{advice, log, panics, progress, ranks, signals, threads};
use nsim_files::{changes, shipped};
use nsim_session::error::Error;

const AFTER_HELP: &str = "\
EXAMPLES:
  nsim energy                          energy of the shipped network, compared with a GPU
  nsim map --target loihi1-chip        how the shipped network fits onto one chip
  nsim run model.ron --input spikes.npy --format json
  nsim inspect model.ron

EXIT STATUS:
  0 done   1 the answer is no   2 wrong usage   3 an input cannot be used   4 a fault of nsim";

/// Heading in help of the options that every command has, after its own.
const EVERYWHERE: &str = "Options of every command";

/// Maps trained spiking networks onto simulated Loihi cores, runs them bit for bit, and reports
/// energy and latency.
#[derive(Debug, Parser)]
#[command(name = "nsim", version, about, after_help = AFTER_HELP, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// How to print the result
    #[arg(long, global = true, help_heading = EVERYWHERE, value_enum, default_value_t)]
    format: Format,
    /// Threads to use, which never changes a result [default: all cores]
    #[arg(long, global = true, help_heading = EVERYWHERE, value_name = "N")]
    threads: Option<usize>,
    /// Replace existing files
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    force: bool,
    /// Change a field of the model, the target or its constants, such as
    /// populations.hidden.vth_mant=60, target.limits.axons_out=8192 or
    /// constants.injection_time=0.4us
    #[arg(long, global = true, help_heading = EVERYWHERE, value_name = "PATH=VALUE", action = clap::ArgAction::Append)]
    set: Vec<String>,
    /// Print more messages on stderr (-v, -vv)
    #[arg(short, long, global = true, help_heading = EVERYWHERE, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Print only errors on stderr
    #[arg(short, long, global = true, help_heading = EVERYWHERE, conflicts_with = "verbose")]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Map a network onto a target: how it fits, or every reason why it does not
    Map(map::MapArgs),
    Run(run::Args),
    /// Estimate power, latency and energy of a network, and compare with other hardware
    Energy(energy::args::EnergyArgs),
    Plot(plot::Args),
    Report(report::Args),
    Compare(compare::Args),
    Agree(agree::Args),
    Convert(convert::Args),
    Bench(bench::Args),
    Scene(scene::Args),
    Sweep(sweep::Args),
    Train(train::Args),
    /// Convert a model of another tool into nsim's format
    Import(import::Args),
    /// Convert a model into a format of other tools (NIR, netx)
    Export(export::Args),
    Stress(stress::Args),
    /// Describe the content of a file
    Inspect(inspect::Args),
    Show(inspect::show::Args),
    /// Print shell completions
    #[command(after_help = "EXAMPLES:\n  nsim completions bash > ~/.local/share/bash-completion/completions/nsim")]
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
    Help(inspect::help::Args),
}

impl Command {
    /// Whether several processes can share the work.
    fn has_ranks(&self) -> bool {
        match self {
            Command::Run(_) | Command::Energy(_) => true,
            Command::Bench(args) => args.has_ranks(),
            _ => false,
        }
    }
}

fn dispatch(command: &Command, context: Context) -> Result<Answer, Error> {
    if !command.has_ranks() {
        ranks::refuse_several("this command")?;
    }
    match command {
        Command::Map(args) => map::run(args, context),
        Command::Run(args) => run::run(args, context),
        Command::Energy(args) => energy::run(args, context),
        Command::Plot(args) => plot::run(args, context),
        Command::Report(args) => report::run(args, context),
        Command::Compare(args) => compare::run(args, context),
        Command::Agree(args) => agree::run(args, context),
        Command::Convert(args) => convert::run(args, context),
        Command::Bench(args) => bench::run(args, context),
        Command::Scene(args) => scene::run(args, context),
        Command::Sweep(args) => sweep::run(args, context),
        Command::Train(args) => train::run(args, context),
        Command::Export(args) => export::run(args, context),
        Command::Import(args) => import::run(args, context),
        Command::Stress(args) => stress::run(args, context),
        Command::Inspect(args) => inspect::run(args, context),
        Command::Show(args) => inspect::show::run(args, context),
        Command::Help(args) => inspect::help::run(args, args::columns::folded(Cli::command()), context),
        Command::Completions { shell } => {
            progress::print(&completions(*shell))?;
            Ok(Answer::Yes)
        }
    }
}

/// Name and options of every command.
fn options_of_commands() -> Vec<(String, Vec<String>)> {
    fn add(command: &clap::Command, name: &str, all: &mut Vec<(String, Vec<String>)>) {
        let named = command.get_arguments().filter_map(clap::Arg::get_long_and_visible_aliases);
        all.push((name.to_string(), named.flatten().map(str::to_string).collect()));
        for below in command.get_subcommands() {
            add(below, format!("{name} {}", below.get_name()).trim_start(), all);
        }
    }
    let (mut root, mut all) = (Cli::command(), Vec::new());
    root.build();
    add(&root, "", &mut all);
    all
}

/// Adds the shipped names to the arguments for models, targets and constants of a command.
fn with_shipped_names(command: clap::Command) -> clap::Command {
    let names: Vec<String> = command.get_subcommands().map(|sub| sub.get_name().to_string()).collect();
    let command = names.into_iter().fold(command, |command, name| command.mut_subcommand(name, with_shipped_names));
    command.mut_args(|arg| {
        let shipped = match arg.get_id().as_str() {
            "model" | "models" => shipped::MODELS,
            "target" | "targets" => shipped::TARGETS,
            "constants" => shipped::CONSTANTS,
            _ => return arg,
        };
        let names: Vec<&'static str> = shipped.iter().map(|file| file.name).collect();
        arg.value_parser(clap::builder::PossibleValuesParser::new(names))
    })
}

/// Completion script of a shell. Bash, zsh and fish complete shipped names and file names. The
/// scripts of other shells complete no files where they have names, so they get no names.
fn completions(shell: clap_complete::Shell) -> String {
    use clap_complete::Shell::{Bash, Fish, Zsh};
    let mut command = match shell {
        Bash | Zsh | Fish => with_shipped_names(Cli::command()),
        _ => Cli::command(),
    };
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, "nsim", &mut script);
    let mut script = String::from_utf8_lossy(&script).into_owned();
    for names in [shipped::MODELS, shipped::TARGETS, shipped::CONSTANTS] {
        let list = names.iter().map(|file| file.name).collect::<Vec<_>>().join(" ");
        // zsh completes only a list in parentheses; `compadd` and `_files` add names and files.
        script = script.replace(&format!(":({list})"), &format!(":{{compadd -- {list}; _files}}"));
        let first = names.first().map_or("", |file| file.name);
        // In fish `-f` means no files.
        let lines = script.lines().map(|line| match shell == Fish && line.contains(&format!(" -a \"{first}\\t")) {
            true => line.replace(" -f ", " -F "),
            false => line.to_string(),
        });
        script = lines.collect::<Vec<_>>().join("\n") + "\n";
    }
    script
}

/// Runs the command line of this process and returns its exit status.
pub fn main() -> ExitCode {
    run_line(std::env::args_os())
}

/// Runs one command line, which begins with the name of the program, and returns its exit status.
/// Threads, log and signal handlers belong to the process, so a process can run only one command.
pub fn run_line(line: impl IntoIterator<Item = OsString>) -> ExitCode {
    let (line, asked): (Vec<OsString>, _) = (line.into_iter().collect(), diagnostics::requested_format());
    match panics::guarded(|| Ok(command(&line, asked))) {
        Ok(status) => status,
        Err(error) => diagnostics::report(&error, asked),
    }
}

fn command(line: &[OsString], asked: Format) -> ExitCode {
    signals::listen(asked);
    ranks::start();
    let mut known = args::columns::folded(Cli::command());
    let parsed = known.try_get_matches_from_mut(line).and_then(|matches| {
        advice::runs(&matches, options_of_commands);
        let name = matches.subcommand_name().unwrap_or_default().to_string();
        Ok((Cli::from_arg_matches(&matches)?, name))
    });
    let (cli, name) = match parsed.map_err(|error| args::removed::explained(error, line, &mut known).format(&mut known))
    {
        Ok(parsed) => parsed,
        Err(error) => {
            let status = diagnostics::usage(&error, asked);
            if status == ExitCode::SUCCESS {
                ranks::finish();
            }
            return status;
        }
    };
    log::start(cli.verbose, cli.quiet, matches!(cli.command, Command::Run(_)));
    if let Err(message) = nsim_machine::lanes::width::check() {
        return diagnostics::report(&Error::Usage(message), cli.format);
    }
    // `--set` of a training names fields of the training file.
    if !matches!(cli.command, Command::Train(_))
        && let Err(error) = changes::set(&cli.set).map_err(Error::Usage).and_then(|()| Ok(changes::check()?))
    {
        return diagnostics::report(&error, cli.format);
    }
    let answer = threads::start(cli.threads).and_then(|threads| {
        let shows_progress = diagnostics::on_terminal() && !cli.quiet;
        if shows_progress {
            progress::start();
        }
        let _busy = progress::stage(format!("nsim {name}"));
        dispatch(&cli.command, Context { format: cli.format, force: cli.force, progress: shows_progress, threads })
    });
    match answer {
        Ok(answer) => {
            for change in changes::unused() {
                tracing::warn!("--set {}: this command reads nothing that has this path", change.path());
            }
            ranks::finish();
            if answer == Answer::Yes { ExitCode::SUCCESS } else { ExitCode::from(1) }
        }
        Err(error) => diagnostics::report(&error, cli.format),
    }
}

#[cfg(test)]
mod tests {
    use crate::cli::*;

    #[test]
    fn shells_complete_shipped_names_and_files() {
        let script = completions(clap_complete::Shell::Bash);
        for names in [shipped::TARGETS, shipped::CONSTANTS] {
            let list = names.iter().map(|file| file.name).collect::<Vec<_>>().join(" ");
            assert!(script.contains(&format!("compgen -W \"{list}\"")), "{list}");
        }
        assert!(script.contains("vtsnn-slip-srm") && script.contains("-o default"));
        let script = completions(clap_complete::Shell::Zsh);
        assert!(
            script.contains(":{compadd -- davies2018")
                && script.contains(":{compadd -- container-few-shot container-tactile "),
            "{script}"
        );
        let fish = completions(clap_complete::Shell::Fish);
        assert!(
            fish.lines().any(|line| line.contains("-l constants") && line.contains("-r -F -a \"davies2018")),
            "{fish}"
        );
        assert!(!script.contains(":(vtsnn-slip"), "a list that leaves no room for files");
    }
}
