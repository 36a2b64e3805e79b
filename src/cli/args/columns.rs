//! Help within the columns of a terminal.
//!
//! Input: the command line as it is declared. Output: the same with help that is wrapped at
//! [`COLUMNS`] and examples that are folded there: what an example does goes onto a line of its
//! own, and a longer command is continued as shells take it.

use clap::Command;

/// Columns of help, those of the narrowest usual terminal.
const COLUMNS: usize = 80;

/// A command and those below it, with help that is so wide at most.
pub(in crate::cli) fn folded(command: Command) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|below| below.get_name().to_string()).collect();
    let command = names.into_iter().fold(command, |command, name| command.mut_subcommand(name, folded));
    let command = command.term_width(COLUMNS);
    match command.get_after_help().map(ToString::to_string) {
        Some(text) => command.after_help(text.lines().map(line).collect::<Vec<_>>().join("\n")),
        None => command,
    }
}

/// A line of the text behind options: an example, two spaces in front, or anything else.
fn line(text: &str) -> String {
    let width = |text: &str| text.chars().count();
    let Some(example) = text.strip_prefix("  ").filter(|_| width(text) > COLUMNS) else { return text.to_string() };
    let (command, does) = example.split_once("  ").unwrap_or((example, ""));
    let mut lines = vec![String::from("  ")];
    for word in command.split(' ') {
        // A space and a backslash may follow.
        if lines.last().is_some_and(|last| width(last) + width(word) + 2 > COLUMNS) {
            lines.last_mut().expect("a line").push('\\');
            lines.push("      ".to_string());
        }
        let last = lines.last_mut().expect("a line");
        last.push_str(word);
        last.push(' ');
    }
    lines.push(format!("      {}", does.trim_start()));
    lines.iter().map(|line| line.trim_end()).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use crate::cli::args::columns::*;

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
