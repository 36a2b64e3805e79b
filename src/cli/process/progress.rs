//! Signs of life on stderr: the stage that a command is at, or a bar.
//!
//! A terminal shows one line at a time. It appears `FIRST_SIGN` after the start of the command and
//! disappears while text is written. A pipe shows nothing.

use std::borrow::Cow;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::cli::context::Context;
use nsim_files as io;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_session::samples::Progress;

/// Time from the start of a command to its first line.
const FIRST_SIGN: Duration = Duration::from_millis(250);
/// Time between two pictures of a line.
const TICK: Duration = Duration::from_millis(100);

/// The line of a terminal.
struct Line {
    all: MultiProgress,
    /// Names the innermost stage; no part of `all` while there is a bar.
    stage: ProgressBar,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    stages: Vec<Cow<'static, str>>,
    bars: usize,
}

static LINE: LazyLock<Line> = LazyLock::new(|| Line {
    all: MultiProgress::with_draw_target(ProgressDrawTarget::hidden()),
    stage: ProgressBar::hidden().with_style(style("{spinner} {msg}, {elapsed}")),
    state: Mutex::default(),
});

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

impl Line {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Shows the innermost stage where there is no bar.
    fn show(&self, state: &State) {
        self.all.remove(&self.stage);
        // A line that cannot be cleared harms nothing.
        let _ = self.all.clear();
        if let Some(stage) = state.stages.last().filter(|_| state.bars == 0) {
            self.stage.set_message(stage.clone());
            self.stage.reset_elapsed();
            self.all.add(self.stage.clone());
        }
    }
}

/// Shows lines from now on, on a terminal that may show them.
pub fn start() {
    // Without a thread there is no line.
    let _ = std::thread::Builder::new().spawn(|| {
        std::thread::sleep(FIRST_SIGN);
        LINE.all.set_draw_target(ProgressDrawTarget::stderr());
        LINE.stage.enable_steady_tick(TICK);
        LINE.stage.tick();
    });
}

/// A stage without countable parts, named until this is dropped.
#[derive(Debug)]
pub struct Stage(());

/// Begins a stage within those that have begun.
pub fn stage(what: impl Into<Cow<'static, str>>) -> Stage {
    let mut state = LINE.state();
    state.stages.push(what.into());
    LINE.show(&state);
    Stage(())
}

impl Drop for Stage {
    fn drop(&mut self) {
        let mut state = LINE.state();
        state.stages.pop();
        LINE.show(&state);
    }
}

/// A stage of countable parts, shown until this is dropped.
#[derive(Debug)]
pub struct Bar {
    bar: ProgressBar,
    /// Whether it is part of the line.
    counts: bool,
}

/// Begins a stage of `length` parts.
pub fn bar(context: Context, length: u64, what: &'static str) -> Bar {
    if !context.progress {
        return Bar { bar: ProgressBar::hidden(), counts: false };
    }
    let mut state = LINE.state();
    state.bars += 1;
    LINE.show(&state);
    let bar = LINE.all.add(ProgressBar::new(length)).with_style(style("{msg} [{bar:40}] {pos}/{len} {eta}"));
    bar.set_message(what);
    bar.enable_steady_tick(TICK);
    Bar { bar, counts: true }
}

impl Bar {
    /// Counts more parts as done.
    pub fn add(&self, parts: u64) {
        self.bar.inc(parts);
    }

    /// Sets the number of parts that are done.
    pub fn set(&self, parts: u64) {
        self.bar.set_position(parts);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        if self.counts {
            self.bar.finish_and_clear();
            LINE.all.remove(&self.bar);
            let mut state = LINE.state();
            state.bars -= 1;
            LINE.show(&state);
        }
    }
}

/// Runs `work` under a bar; it calls its argument after each of `length` parts.
pub fn with_bar<T>(context: Context, length: usize, what: &'static str, work: impl FnOnce(Progress<'_>) -> T) -> T {
    let bar = bar(context, length as u64, what);
    work(&|| bar.add(1))
}

/// Runs `write`, which writes to the terminal, while no line is shown.
pub fn without_line<T>(write: impl FnOnce() -> T) -> T {
    LINE.all.suspend(write)
}

/// Writes a result to stdout.
///
/// # Errors
/// Those of [`io::write::stdout`].
pub fn print(text: &str) -> Result<(), Diagnostic> {
    without_line(|| io::write::stdout(text))
}
