//! Advice that names options of commands other than the running one.
//!
//! Input: advice of stages, which do not know the running command. Output: the advice, with a
//! command for each option that the running command lacks. If the advice names a command, the
//! options after it are checked against that command.

use std::sync::OnceLock;

use clap::ArgMatches;

/// Name and options of every command.
type Commands = Vec<(String, Vec<String>)>;

/// Name of the running command, and the function that lists all commands.
static RUNS: OnceLock<(String, fn() -> Commands)> = OnceLock::new();

/// Stores the name of the running command; `all` lists the commands.
pub fn runs(matches: &ArgMatches, all: fn() -> Commands) {
    let (mut names, mut matches) = (Vec::new(), matches);
    while let Some((name, below)) = matches.subcommand() {
        names.push(name);
        matches = below;
    }
    let _ = RUNS.set((names.join(" "), all));
}

/// Advice with a command for each option that the running command lacks.
pub fn with_owners(advice: &str) -> String {
    match RUNS.get() {
        Some((runs, all)) if advice.contains("--") => completed(advice, runs, &all()),
        _ => advice.to_string(),
    }
}

fn completed(advice: &str, runs: &str, commands: &[(String, Vec<String>)]) -> String {
    let words: Vec<&str> = advice.split(|c: char| !c.is_ascii_alphanumeric() && c != '-').collect();
    let has = |command: &str, option: &str| {
        commands.iter().any(|(name, options)| name == command && options.iter().any(|one| one == option))
    };
    let (mut command, mut advice) = (runs, advice.to_string());
    for (place, word) in words.iter().enumerate() {
        let behind = words[place + 1..].join(" ") + " ";
        let named = commands.iter().filter(|(name, _)| !name.is_empty() && behind.starts_with(&format!("{name} ")));
        if let (true, Some((name, _))) = (*word == "nsim", named.max_by_key(|(name, _)| name.len())) {
            command = name;
        }
        let Some(option) = word.strip_prefix("--").filter(|option| !has(command, option)) else { continue };
        let owner = commands.iter().find(|(_, options)| options.iter().any(|one| one == option));
        let said = owner.map(|(name, _)| format!(" (nsim {name} has --{option})"));
        if let Some(said) = said.filter(|said| !advice.contains(said)) {
            advice += &said;
        }
    }
    advice
}

#[cfg(test)]
mod tests {
    use crate::cli::process::advice::*;

    #[test]
    fn an_option_of_another_command_is_named_with_it() {
        let options = |names: &[&str]| names.iter().map(|name| (*name).to_string()).collect::<Vec<_>>();
        let commands = [
            ("map".to_string(), options(&["relays", "copies"])),
            ("agree".to_string(), options(&["input"])),
            ("bench map".to_string(), options(&["full"])),
        ];
        for (advice, runs, added) in [
            ("let `--relays` help, or --relays", "agree", " (nsim map has --relays)"),
            ("let --relays help", "map", ""),
            ("say nsim map --relays", "agree", ""),
            ("say nsim bench map --full", "agree", ""),
            ("build with --features x", "agree", ""),
            ("a dash -- is none", "agree", ""),
        ] {
            assert_eq!(completed(advice, runs, &commands), format!("{advice}{added}"), "{runs}");
        }
    }
}
