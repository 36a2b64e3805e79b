//! Everything that can end a command early, and its exit status.

use std::borrow::Cow;

use nsim_compile::{CompileError, Reason};
use nsim_files::target::shipped_with;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::neurons::NeuronKind;

/// What a command's work returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a command could not do its work.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input cannot be read or is not supported: exit status 3.
    #[error("{0}")]
    Input(Box<Diagnostic>),
    /// A network does not fit its target: an answer of commands that map, an unusable input, exit
    /// status 3, of all others.
    #[error("{}", CompileError::DoesNotFit(.0.clone()))]
    DoesNotFit(Vec<Reason>),
    /// What is asked for makes no sense: exit status 2.
    #[error("{0}")]
    Usage(String),
    /// An internal error: exit status 4.
    #[error("this is a fault of nsim: {0}")]
    Fault(String),
}

impl Error {
    /// The process's exit status.
    pub fn exit_status(&self) -> u8 {
        match self {
            Error::Usage(_) => 2,
            // What was asked for is not done with any input.
            Error::Input(diagnostic) if diagnostic.code == "write.not-regular" => 2,
            Error::Input(_) | Error::DoesNotFit(_) => 3,
            Error::Fault(_) => 4,
        }
    }

    /// What is wrong with an input, where it is that.
    pub fn diagnostic(&self) -> Option<Cow<'_, Diagnostic>> {
        match self {
            Error::Input(diagnostic) => Some(Cow::Borrowed(diagnostic)),
            Error::DoesNotFit(_) => Some(Cow::Owned(Diagnostic::new(self.code(), self.to_string()))),
            Error::Usage(_) | Error::Fault(_) => None,
        }
    }

    /// A word for the problem: that of its diagnostic, `usage` or `fault`.
    pub fn code(&self) -> &'static str {
        match self {
            Error::Usage(_) => "usage",
            Error::Fault(_) => "fault",
            Error::Input(diagnostic) => diagnostic.code,
            Error::DoesNotFit(_) => "map.does-not-fit",
        }
    }
}

impl From<Diagnostic> for Error {
    fn from(diagnostic: Diagnostic) -> Self {
        Error::Input(Box::new(diagnostic))
    }
}

/// The diagnostic, with the shipped targets that have every kind of neurons where the target lacks
/// one.
fn with_targets(diagnostic: Diagnostic) -> Diagnostic {
    let (Some(help), "map.neuron-kind" | "map.message") = (&diagnostic.help, diagnostic.code) else {
        return diagnostic;
    };
    let targets = shipped_with(&NeuronKind::ALL.into_iter().collect());
    let named: Vec<String> = targets.iter().map(|target| format!("--target {}", target.name())).collect();
    let help = format!("{help}: {}", named.join(", "));
    diagnostic.help(help)
}

impl From<CompileError> for Error {
    fn from(error: CompileError) -> Self {
        match error {
            CompileError::Input(diagnostic) => with_targets(diagnostic).into(),
            CompileError::Fault(message) => Error::Fault(message),
            CompileError::DoesNotFit(reasons) => Error::DoesNotFit(reasons),
        }
    }
}
