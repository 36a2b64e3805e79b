//! `nsim help`: the text of `--help`, and the manual pages of all commands.

use std::path::PathBuf;

use clap::Command;

use crate::cli::context::{Answer, Context};
use crate::cli::process::progress;
use nsim_files as io;
use nsim_session::error::Error;

/// Print this message, the help of a command, or write manual pages
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim help energy
  nsim help bench map
  nsim help --man share/man/man1           manual pages of all commands, for man(1)")]
pub struct Args {
    /// A command, and its subcommand
    #[arg(value_name = "COMMAND")]
    pub commands: Vec<String>,
    /// Write the manual pages of all commands into this folder
    #[arg(long, value_name = "DIR", conflicts_with = "commands")]
    pub man: Option<PathBuf>,
}

/// Prints the help of a command below `root`, or writes the manual pages.
pub fn run(args: &Args, root: Command, context: Context) -> Result<Answer, Error> {
    let mut root = root;
    root.build();
    if let Some(folder) = &args.man {
        let mut pages = Vec::new();
        manual(&root, &mut pages)?;
        let files: Vec<PathBuf> = pages.iter().map(|(name, _)| folder.join(format!("{name}.1"))).collect();
        io::write::check_all_free(&files, context.force)?;
        let mut batch = io::write::Batch::new(context.force);
        for (path, (_, page)) in files.iter().zip(&pages) {
            batch.add(path, |out| out.write_all(page))?;
        }
        batch.commit()?;
        progress::print(&format!("{} manual pages in {}\n", pages.len(), folder.display()))?;
        return Ok(Answer::Yes);
    }
    let mut command = &mut root;
    for name in &args.commands {
        let message = format!("there is no command '{name}' here; nsim help lists them");
        command = command.find_subcommand_mut(name).ok_or(Error::Usage(message))?;
    }
    progress::print(&command.render_long_help().to_string())?;
    Ok(Answer::Yes)
}

/// Adds the name and manual page of a command and of all its subcommands.
fn manual(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), Error> {
    let name = command.get_display_name().unwrap_or(command.get_name()).to_string();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone())
        .title(name.to_uppercase())
        .render(&mut page)
        .map_err(|error| Error::Fault(format!("a manual page: {error}")))?;
    pages.push((name, page));
    command.get_subcommands().filter(|below| below.get_name() != "help").try_for_each(|below| manual(below, pages))
}
