//! Signals: SIGINT and SIGTERM end a command with status 130 and 143 and leave no temporary file.
//!
//! SIGXFSZ (a file beyond its limit) only interrupts the write, which fails with an error of its
//! own. SIGABRT, which follows exhausted memory and an exhausted stack, ends with status 4 after
//! the message of Rust's runtime.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use serde_json::json;
use signal_hook::consts::{SIGABRT, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use signal_hook::iterator::Signals;

use crate::cli::context::Format;
use crate::cli::diagnostics;
use crate::cli::process::progress;
use crate::cli::process::ranks;
use nsim_files::write;

/// Last action of a command that a signal ends: it saves finished work and returns a message.
type LastAction = Box<dyn FnOnce() -> Option<String> + Send>;

static LAST_ACTION: Mutex<Option<LastAction>> = Mutex::new(None);

/// Guard of a last action, which stays registered until the guard is dropped.
#[derive(Debug)]
pub struct ActionGuard(());

/// Registers an action that a signal runs before it ends the process.
pub fn at_end(last: impl FnOnce() -> Option<String> + Send + 'static) -> ActionGuard {
    if let Ok(mut place) = LAST_ACTION.lock() {
        *place = Some(Box::new(last));
    }
    ActionGuard(())
}

impl Drop for ActionGuard {
    fn drop(&mut self) {
        if let Ok(mut place) = LAST_ACTION.lock() {
            *place = None;
        }
    }
}

/// Starts to handle signals. If the system refuses, signals keep their default actions.
pub fn listen(format: Format) {
    let _ = flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
    let _ = flag::register_conditional_shutdown(SIGABRT, 4, Arc::new(AtomicBool::new(true)));
    // A later signal ends the process immediately. A signal within 300 ms is ignored, as `timeout`
    // signals the process and its group.
    let ending = Arc::new(AtomicBool::new(false));
    let Ok(mut signals) = Signals::new([SIGINT, SIGTERM]) else { return };
    for signal in [SIGINT, SIGTERM] {
        let _ = flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&ending));
    }
    let handle = signals.handle();
    let thread = std::thread::Builder::new().name("signals".into()).stack_size(2 << 20).spawn(move || {
        if let Some(signal) = signals.forever().next() {
            let later = std::thread::Builder::new().stack_size(64 << 10).spawn(move || {
                std::thread::sleep(std::time::Duration::from_millis(300));
                ending.store(true, Ordering::SeqCst);
            });
            drop(later);
            end(signal, format);
        }
    });
    if thread.is_err() {
        handle.close();
        // Without a thread signals end the process immediately, and temporary files remain.
        for signal in [SIGINT, SIGTERM] {
            let _ = flag::register_conditional_shutdown(signal, 128 + signal, Arc::new(AtomicBool::new(true)));
        }
    }
}

fn end(signal: i32, format: Format) {
    let name = if signal == SIGINT { "SIGINT" } else { "SIGTERM" };
    // The command runs on meanwhile, and may end before the process is ended.
    let last = LAST_ACTION.lock().ok().and_then(|mut last| last.take());
    let saved_state = last.and_then(|last| last());
    let unfinished: Vec<String> = write::abandon().iter().map(|folder| folder.display().to_string()).collect();
    if ranks::is_reported_elsewhere() {
        std::process::exit(128 + signal);
    }
    let mut message = format!("ended by {name}; every file is unchanged, complete, or absent");
    if !unfinished.is_empty() {
        message += &format!("; {} is unfinished and the same command completes it", unfinished.join(", "));
    }
    if let Some(saved_state) = saved_state {
        message += &format!("; {saved_state}");
    }
    if format == Format::Json && !write::has_printed() {
        let object = json!({
            "schema": "nsim.error/1", "code": "interrupted", "message": message, "help": null,
            "file": null, "line": null, "column": null,
        });
        let _ = progress::print(&format!("{object:#}\n"));
    } else {
        diagnostics::write_stderr(&format!("nsim: {message}\n"));
    }
    std::process::exit(128 + signal);
}
