//! Help within the columns of a terminal: a summary with `-h`, everything with `--help`.
//!
//! Input: the declared command line. Output: the same with two help texts. `--help` is clap's text,
//! wrapped at [`COLUMNS`]. In its examples the description gets a line of its own, and a long
//! command is continued as in shells. `-h` lists the options of [`MOST_USED`] with the first clause
//! of their help, and two examples.

use clap::builder::{Str, StyledStr};
use clap::{Arg, ArgAction, Command};

use nsim_files::table::{shell_lines, wrapped_at};

/// Columns of help, as many as the narrowest usual terminal has.
const COLUMNS: usize = 80;
/// Column at which `-h` describes an option.
const TEXT: usize = 28;
/// Options that `-h` lists for a command that is not in [`MOST_USED`].
const MOST: usize = 8;

/// The options that `-h` lists.
const MOST_USED: [(&str, &str); 12] = [
    ("nsim map", "target copies deployment objective prune mapping plot output"),
    ("nsim run", "target input samples engine early_exit probe mapping output"),
    ("nsim energy", "target input samples copies deployment baseline plot full"),
    ("nsim compare", "targets input samples mode"),
    ("nsim agree", "input samples against target plot require_class_agreement require_exact"),
    ("nsim convert", "input samples calibrate target output"),
    ("nsim import", "dt_ms neuron reset decay input_shape output"),
    ("nsim report", "target input samples copies deployment baseline output"),
    ("nsim plot", "target input samples probe output"),
    ("nsim train", "train test seed epochs folds set log output"),
    ("nsim bench pareto", "input samples seconds plot"),
    ("nsim bench paper", "full train cell results output"),
];

/// Reference of `-h` to the options that it does not list.
const OTHERS: &str = "--format, --threads, --set and all other options: ";

/// Commands by purpose, as `nsim -h` lists them.
const GROUPS: [(&str, &[&str]); 4] = [
    ("Your network", &["map", "run", "energy", "compare", "agree", "convert", "import", "export", "report", "plot"]),
    ("Studies", &["sweep", "train", "scene", "bench paper"]),
    ("Files and help", &["inspect", "show", "help", "completions"]),
    ("Checks of nsim itself", &["stress", "bench"]),
];

/// A command and its subcommands, with help of at most [`COLUMNS`] columns.
pub(in crate::cli) fn folded(command: Command) -> Command {
    let name = command.get_name().to_string();
    let help = folded_as(command, &name);
    // The groups replace clap's one list.
    let about = help.get_about().map(ToString::to_string).unwrap_or_default();
    let group = |(title, names): &(&str, &[&str])| {
        let line = |name: &&str| {
            let below = name.split(' ').try_fold(&help, |command, name| command.find_subcommand(name));
            entry(name, 16, below.and_then(Command::get_about))
        };
        format!("\n{title}:\n{}", names.iter().map(line).collect::<String>())
    };
    let groups = format!("{about}\n{}", GROUPS.iter().map(group).collect::<String>());
    let version = Arg::new("version").short('V').long("version").action(ArgAction::Version);
    help.mut_subcommands(|below| below.hide(true))
        .override_usage("nsim [OPTIONS] <COMMAND>")
        .disable_version_flag(true)
        .arg(version.hide_short_help(true).help("Print version"))
        .about(groups.trim_end().replace("\n\n", "\n") + "\n\n" + OTHERS + "nsim --help")
        .long_about(groups)
        .after_help("")
        .help_template("{usage-heading} {usage}\n\n{about}\n{all-args}{after-help}")
}

fn folded_as(command: Command, path: &str) -> Command {
    let command = command.mut_subcommands(|below| {
        let path = format!("{path} {}", below.get_name());
        folded_as(below, &path)
    });
    let lines = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let all: Vec<String> = lines.lines().map(line).collect();
    let short = short(&command, path, &all);
    let help = Arg::new("help").short('h').long("help").action(ArgAction::Help);
    command
        .term_width(COLUMNS)
        .disable_help_flag(true)
        .mut_args(|arg| arg.hide_short_help(true))
        .arg(help.hide_short_help(true).help("Print help (see a summary with '-h')"))
        .after_help(short)
        .after_long_help(all.join("\n"))
}

/// Text of `-h` after the usage.
fn short(command: &Command, path: &str, examples: &[String]) -> String {
    let named = MOST_USED.iter().find(|(name, _)| *name == path).map(|(_, names)| names.split(' '));
    let options: Vec<&Arg> = match named {
        Some(names) => names.filter_map(|name| command.get_arguments().find(|arg| arg.get_id() == name)).collect(),
        None => command.get_arguments().filter(|arg| !arg.is_positional()).take(MOST).collect(),
    };
    let mut out = String::new();
    for (title, listed) in [("Arguments", command.get_positionals().collect()), ("Most used options", options)] {
        let list: String = listed.iter().map(|arg| entry(&spelled(arg), TEXT, arg.get_help())).collect();
        if !list.is_empty() {
            out += &format!("{title}:\n{list}\n");
        }
    }
    let third = examples.iter().enumerate().filter(|(_, line)| line.starts_with("  nsim")).nth(2);
    let examples = examples[..third.map_or(examples.len(), |(at, _)| at)].join("\n");
    format!("{out}{examples}\n\n{OTHERS}{path} --help")
}

/// An argument as the user types it.
fn spelled(arg: &Arg) -> String {
    let short = arg.get_short().map(|short| format!("-{short}, ")).unwrap_or_default();
    let names = arg.get_value_names().filter(|_| arg.get_action().takes_values());
    let value = names.map(|names| names.iter().map(Str::as_str).collect::<Vec<_>>().join(" "));
    match (arg.get_long(), value) {
        (Some(long), Some(value)) => format!("{short}--{long} {value}"),
        (Some(long), None) => format!("{short}--{long}"),
        (None, value) => value.unwrap_or_else(|| arg.get_id().to_string().to_uppercase()),
    }
}

/// A line of a list: a name, and at `column` the text or its first clause.
fn entry(name: &str, column: usize, text: Option<&StyledStr>) -> String {
    let text = text.map(ToString::to_string).unwrap_or_default();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let text = text.split(" [").next().unwrap_or_default().trim_end_matches(',');
    let room = COLUMNS - column;
    let whole = Some(text.len()).filter(|_| text.chars().count() <= room);
    let end = whole.or_else(|| ends(text, [": ", "; "], room).min());
    let end = end.or_else(|| ends(text, [", ", " ("], room).max());
    let text = wrapped_at(end.map_or(text, |end| &text[..end]), column);
    let below = if name.chars().count() + 4 > column { format!("\n{:column$}", "") } else { String::new() };
    format!("  {name:width$}{below}{text}\n", width = if below.is_empty() { column - 2 } else { 0 })
}

/// Offsets at which a text may be cut: before a separator, within `room` columns.
fn ends(text: &str, separators: [&'static str; 2], room: usize) -> impl Iterator<Item = usize> {
    let all = separators.into_iter().flat_map(move |separator| text.match_indices(separator));
    all.map(|(at, _)| at).filter(move |&at| text[..at].chars().count() <= room)
}

/// Folds a line after the options if it is a long example (two spaces first).
fn line(text: &str) -> String {
    let Some(example) = text.strip_prefix("  ").filter(|_| text.chars().count() > COLUMNS) else {
        return text.to_string();
    };
    let (command, does) = example.split_once("  ").unwrap_or((example, ""));
    let command = shell_lines(command);
    if does.is_empty() { command } else { format!("{command}\n      {}", does.trim_start()) }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use crate::cli::args::columns::*;

    #[test]
    fn what_short_help_lists_is_there() {
        let mut root = crate::cli::Cli::command();
        root.build();
        for (path, options) in MOST_USED {
            let below = path.split(' ').skip(1).try_fold(&root, |command, name| command.find_subcommand(name)).unwrap();
            for option in options.split(' ') {
                assert!(below.get_arguments().any(|arg| arg.get_id() == option), "{path}: {option}");
            }
        }
        let listed = GROUPS.iter().flat_map(|(_, names)| *names).filter(|name| !name.contains(' '));
        assert_eq!(listed.count(), root.get_subcommands().count());
    }

    #[test]
    fn examples_are_folded_between_words() {
        let short = "  nsim map   cores";
        assert_eq!(line(short), short);
        let long = format!("  nsim map model.ron{}what it does", " ".repeat(70));
        assert_eq!(line(&long), "  nsim map model.ron\n      what it does");
        let long = format!("  nsim run {}", ["--input spikes.npy"; 5].join(" "));
        let folded = line(&long);
        assert!(folded.lines().all(|line| line.len() <= COLUMNS), "{folded}");
        assert_eq!(folded.replace("\\\n      ", ""), long);
    }
}
