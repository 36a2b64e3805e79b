//! Errors that end a command, and their exit statuses.

use std::borrow::Cow;

use nsim_compile::{CompileError, Reason};
use nsim_files::target::shipped_with_kinds;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::neurons::NeuronKind;

/// Result of a command.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The reason why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input cannot be read or is not supported: exit status 3.
    #[error("{0}")]
    Input(Box<Diagnostic>),
    /// A network does not fit its target: a result of commands that map, for all others an unusable
    /// input with exit status 3.
    #[error("{}", CompileError::DoesNotFit(.0.clone()))]
    DoesNotFit(Vec<Reason>),
    /// The request makes no sense: exit status 2.
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
            // The request is wrong for every input.
            Error::Input(diagnostic) if diagnostic.code == "write.not-regular" => 2,
            Error::Input(_) | Error::DoesNotFit(_) => 3,
            Error::Fault(_) => 4,
        }
    }

    /// Returns the diagnostic of an error of the input; `None` for other errors.
    pub fn diagnostic(&self) -> Option<Cow<'_, Diagnostic>> {
        match self {
            Error::Input(diagnostic) => Some(Cow::Borrowed(diagnostic)),
            Error::DoesNotFit(_) => Some(Cow::Owned(Diagnostic::new(self.code(), self.to_string()))),
            Error::Usage(_) | Error::Fault(_) => None,
        }
    }

    /// Returns the code of the error: of its diagnostic, `usage` or `fault`.
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

/// Returns the diagnostic. Where the target lacks a kind of neurons or messages, the help lists the
/// shipped targets with every kind of neurons.
fn with_targets(diagnostic: Diagnostic) -> Diagnostic {
    let (Some(help), "map.neuron-kind" | "map.message") = (&diagnostic.help, diagnostic.code) else {
        return diagnostic;
    };
    let targets = shipped_with_kinds(&NeuronKind::ALL.into_iter().collect());
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
