//! Fields of model, target and constants that the command line changes.
//!
//! Input: `PATH=VALUE`, once for the whole process, and more for a while for one thread, whose sweep tries them. Output: the text of a model with these values, a target file that changes another, a
//! preset of constants with other numbers. Paths that begin with `target.` are of the target, those with `constants.` of its constants,
//! all others of the model.
//!
//! Errors: `set.path` for a path that leads nowhere, `set.value` for a value that is not what the path's field holds.

pub mod ron_path;

use std::cell::RefCell;
use std::sync::OnceLock;

use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::desc::target::constants::{Constants, Status, classes_of};

/// One change.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Change {
    path: String,
    value: String,
}

static CHANGES: OnceLock<Vec<Change>> = OnceLock::new();

thread_local! {
    /// What this thread changes besides.
    static OF_THREAD: RefCell<Vec<Change>> = const { RefCell::new(Vec::new()) };
}

impl Change {
    /// A value for a path.
    #[must_use]
    pub fn new(path: &str, value: &str) -> Self {
        Change { path: path.trim().to_string(), value: value.trim().to_string() }
    }

    /// From `PATH=VALUE`.
    ///
    /// # Errors
    /// A sentence for anything else.
    pub fn parse(typed: &str) -> Result<Self, String> {
        match typed.split_once('=') {
            Some((path, value)) if !path.is_empty() && !value.trim().is_empty() => Ok(Change::new(path, value)),
            _ => Err(format!("--set {typed}: write PATH=VALUE, such as populations.hidden.vth_mant=60")),
        }
    }

    /// Whether it changes the target or its constants, and no model.
    #[must_use]
    pub fn is_of_target(&self) -> bool {
        let first = self.path.split('.').next();
        first.is_some_and(|first| ["target", "constants"].contains(&first))
    }
}

impl Change {
    /// Whether it changes a population of the model.
    #[must_use]
    pub fn is_of_population(&self) -> bool {
        self.path.starts_with("populations.")
    }

    /// Whether it changes the population of this name and number of the model.
    #[must_use]
    pub fn is_of(&self, population: &str, number: usize) -> bool {
        let named = self.path.strip_prefix("populations.").and_then(|rest| rest.split_once('.'));
        named.is_some_and(|(named, _)| named == population || named.parse() == Ok(number))
    }
}

/// Ends the changes of a thread, however its work ends.
struct Ending;

impl Drop for Ending {
    fn drop(&mut self) {
        OF_THREAD.with_borrow_mut(Vec::clear);
    }
}

/// Reads files under these changes besides those of the process. Only what this thread reads itself is changed.
pub fn within<T>(changes: &[Change], read: impl FnOnce() -> T) -> T {
    OF_THREAD.with_borrow_mut(|of_thread| of_thread.extend_from_slice(changes));
    let _ending = Ending;
    read()
}

/// Sets what this process changes, at most once.
///
/// # Errors
/// A sentence for what is not `PATH=VALUE`.
pub fn set(typed: &[String]) -> Result<(), String> {
    let changes = typed.iter().map(|typed| Change::parse(typed)).collect::<Result<_, _>>()?;
    // Whoever set them first has read files with them.
    let _ = CHANGES.set(changes);
    Ok(())
}

/// What this process changes.
#[must_use]
pub fn of_process() -> &'static [Change] {
    CHANGES.get().map_or(&[], Vec::as_slice)
}

/// The changes whose paths begin so, or of the model, and the rest of their paths.
fn changes(of: Option<&str>) -> Vec<(String, String)> {
    let one = |change: &Change| {
        let (first, rest) = change.path.split_once('.').unwrap_or((&change.path, ""));
        let path = match of {
            Some(of) => (first == of && !rest.is_empty()).then_some(rest),
            None => (!change.is_of_target()).then_some(change.path.as_str()),
        };
        Some((path?.to_string(), change.value.clone()))
    };
    let of_process = CHANGES.get().into_iter().flatten().filter_map(one);
    of_process.chain(OF_THREAD.with_borrow(|of_thread| of_thread.iter().filter_map(one).collect::<Vec<_>>())).collect()
}

fn nowhere(path: &str, message: &str) -> Diagnostic {
    Diagnostic::new("set.path", format!("--set {path}: {message}"))
        .help("nsim show NAME prints a shipped file, whose fields paths are made of")
}

/// The text of a model with the values that are set.
///
/// # Errors
/// `set.path`.
pub fn model(source: SourceText) -> Result<SourceText> {
    let mut text: Option<String> = None;
    for (path, value) in changes(None) {
        let before = text.as_deref().unwrap_or(source.text());
        text = Some(ron_path::replaced(before, &path, &value).map_err(|message| nowhere(&path, &message))?);
    }
    Ok(match text {
        Some(text) => SourceText::new(source.path(), text),
        None => source,
    })
}

/// The fields of the target that are set, as a target file has them; nothing when none is.
#[must_use]
pub fn target_fields() -> Option<String> {
    let mut text = "Target()".to_string();
    let mut any = false;
    for (path, value) in changes(Some("target")) {
        any = true;
        text = with_parents(text, &path, &value);
    }
    let fields = text.strip_prefix("Target(")?.strip_suffix(')')?.to_string();
    any.then_some(fields)
}

/// A value at a path whose parents are made where they are absent.
fn with_parents(mut text: String, path: &str, value: &str) -> String {
    for (at, _) in path.match_indices('.') {
        let parent = &path[..at];
        if ron_path::replaced(&text, &format!("{parent}.x"), "0").is_err() {
            text = ron_path::replaced(&text, parent, "()").unwrap_or(text);
        }
    }
    ron_path::replaced(&text, path, value).unwrap_or(text)
}

/// Gives constants the numbers that are set.
///
/// # Errors
/// `set.path`, `set.value`.
pub fn constants(constants: &mut Constants) -> Result<()> {
    for (path, value) in changes(Some("constants")) {
        let name = path.strip_suffix(".value").unwrap_or(&path);
        let missing = || nowhere(&format!("constants.{path}"), "the constants have no such number");
        let constant = constants.get_mut(name).ok_or_else(missing)?;
        let number = constant.unit.parsed(&value).map_err(|message| {
            let help = format!("write --set constants.{path}=NUMBER{}", constant.unit.suffix());
            Diagnostic::new("set.value", format!("--set constants.{path}={value}: {message}")).help(help)
        })?;
        constant.value = number.into();
        (constant.source, constant.status) = ("given on the command line".to_string(), Status::Assumed);
        constant.findings.clear();
        constants.forget_errors(classes_of(name));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parents_are_made_where_they_are_absent() {
        let one = with_parents("Target()".to_string(), "limits.axons_out", "8192");
        assert_eq!(one, "Target( limits: ( axons_out: 8192))");
        let two = with_parents(one, "limits.axons_in", "7");
        assert_eq!(two, "Target( limits: ( axons_out: 8192, axons_in: 7))");
        assert_eq!(with_parents(two, "chips_x", "2"), "Target( limits: ( axons_out: 8192, axons_in: 7), chips_x: 2)");
    }

    #[test]
    fn a_thread_s_changes_end_with_its_work() {
        let read = || model(SourceText::new("m", "Network(a: 1, b: 2)")).unwrap().text().to_string();
        let changed = within(&[Change::new("a", "5"), Change::new("target.x", "7")], read);
        assert_eq!((changed.as_str(), read().as_str()), ("Network(a: 5, b: 2)", "Network(a: 1, b: 2)"));
        let of_target = within(&[Change::new("target.x", "7")], target_fields);
        assert_eq!((of_target.as_deref(), target_fields()), (Some(" x: 7"), None));
    }

    #[test]
    fn what_is_no_path_and_value_is_refused() {
        for wrong in ["a", "=1", "a=", "a= "] {
            assert!(set(&[wrong.to_string()]).unwrap_err().contains("PATH=VALUE"), "{wrong}");
        }
    }
}
