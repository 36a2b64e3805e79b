//! Fields of the model, the target and the constants that the command line changes.
//!
//! Input: `PATH=VALUE`, set once for the process; a thread of a sweep adds some for a time. Output:
//! the text of a model with these values, the changed fields of a target, constants with other
//! numbers. Paths that begin with `target.` are of the target, paths with `constants.` of its
//! constants, all others of the model.
//!
//! Errors: `set.path` for a path without a field, `set.value` for a value that is not of the
//! field's type.

use std::cell::RefCell;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::hardware::constants::{Constants, SET_OPTION, Status, classes_of};
use nsim_ir::locate;
use nsim_ir::resource::Limits;

/// A value for the field at a path.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Change {
    path: String,
    value: String,
}

static PROCESS_CHANGES: OnceLock<Vec<Change>> = OnceLock::new();
/// Whether a reader has asked for the changes of the target, the constants, a model.
static READ: [AtomicBool; 3] = [const { AtomicBool::new(false) }; 3];

thread_local! {
    /// The changes of this thread, in addition to the process's.
    static THREAD_CHANGES: RefCell<Vec<Change>> = const { RefCell::new(Vec::new()) };
}

impl Change {
    /// A value for a path. A constant's path may end with `.value`, which is dropped.
    pub fn new(path: &str, value: &str) -> Self {
        let path = path.trim();
        let constant = path.strip_prefix("constants.").and_then(|_| path.strip_suffix(".value"));
        Change { path: constant.unwrap_or(path).to_string(), value: value.trim().to_string() }
    }

    /// Checks that its path can name a field and that its value is one RON value.
    ///
    /// # Errors
    /// `set.path`, `set.value`.
    pub fn check(&self) -> Result<()> {
        let Change { path, value } = self;
        if ["target", "constants"].contains(&path.as_str()) || path.split('.').any(|part| part.trim().is_empty()) {
            return Err(path_error(path, "the path does not name a field; it has to end with the name of one"));
        }
        match locate::is_one_value(value) {
            true => Ok(()),
            false => Err(Diagnostic::new("set.value", format!("--set {path}={value}: this is not a single value"))
                .help("write a number, a text in quotes, or a list or struct with its brackets closed")),
        }
    }

    /// Parses `PATH=VALUE`.
    ///
    /// # Errors
    /// A message for any other text.
    pub fn parse(typed: &str) -> Result<Self, String> {
        match typed.split_once('=') {
            Some((path, value)) if !path.is_empty() && !value.trim().is_empty() => Ok(Change::new(path, value)),
            _ => Err(format!("--set {typed}: write PATH=VALUE, such as populations.hidden.vth_mant=60")),
        }
    }

    /// The path of its field.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Whether it changes the target or its constants, and no model.
    pub fn changes_target(&self) -> bool {
        let first = self.path.split('.').next();
        first.is_some_and(|first| ["target", "constants"].contains(&first))
    }

    /// Its path within the target, the constants or (`None`) the model, and its value.
    fn within(&self, of: Option<&str>) -> Option<(String, String)> {
        let (first, rest) = self.path.split_once('.').unwrap_or((&self.path, ""));
        let path = match of {
            Some(of) => (first == of && !rest.is_empty()).then_some(rest),
            None => (!self.changes_target()).then_some(self.path.as_str()),
        };
        Some((path?.to_string(), self.value.clone()))
    }
}

/// Clears the changes of a thread when dropped, also on a panic.
struct ClearOnDrop;

impl Drop for ClearOnDrop {
    fn drop(&mut self) {
        THREAD_CHANGES.with_borrow_mut(Vec::clear);
    }
}

/// Runs `read` with these changes, added to the process's for files that this thread reads.
pub fn with_changes<T>(changes: &[Change], read: impl FnOnce() -> T) -> T {
    THREAD_CHANGES.with_borrow_mut(|thread_changes| thread_changes.extend_from_slice(changes));
    let _clear = ClearOnDrop;
    read()
}

/// Sets the changes of this process; later calls have no effect.
///
/// # Errors
/// A message for a text that is not `PATH=VALUE`.
pub fn set(typed: &[String]) -> Result<(), String> {
    let changes = typed.iter().map(|typed| Change::parse(typed)).collect::<Result<_, _>>()?;
    // Files may have been read with the first changes, so a second set is ignored.
    let _ = PROCESS_CHANGES.set(changes);
    Ok(())
}

/// Checks the changes of this process, before it reads files.
/// Errors are those of [`Change::check`].
pub fn check() -> Result<()> {
    process_changes().iter().try_for_each(Change::check)
}

/// The changes of this process for which no file has been read.
pub fn unused() -> impl Iterator<Item = &'static Change> {
    process_changes().iter().filter(|change| {
        let of = ["target", "constants"].into_iter().find(|of| change.path.split('.').next() == Some(of));
        !READ[reader_index(of)].load(Ordering::Relaxed)
    })
}

/// Index into [`READ`] of the target, the constants, or (`None`) the model.
fn reader_index(of: Option<&str>) -> usize {
    of.map_or(2, |of| usize::from(of != "target"))
}

/// The changes of this process.
pub fn process_changes() -> &'static [Change] {
    PROCESS_CHANGES.get().map_or(&[], Vec::as_slice)
}

/// Paths and values of the changes of the target, the constants or (`None`) the model.
fn changes(of: Option<&str>) -> Vec<(String, String)> {
    READ[reader_index(of)].store(true, Ordering::Relaxed);
    let mut all: Vec<(String, String)> = process_changes().iter().filter_map(|change| change.within(of)).collect();
    THREAD_CHANGES.with_borrow(|changes| all.extend(changes.iter().filter_map(|change| change.within(of))));
    all
}

fn path_error(path: &str, message: &str) -> Diagnostic {
    Diagnostic::new("set.path", format!("--set {path}: {message}"))
        .help("paths consist of names of fields: nsim show NAME prints a shipped file with its fields")
}

/// The text of a model with the values that are set.
///
/// # Errors
/// `set.path`.
pub fn model(source: SourceText) -> Result<SourceText> {
    let changes = changes(None);
    if changes.is_empty() {
        return Ok(source);
    }
    let pairs: Vec<(&str, &str)> = changes.iter().map(|(path, value)| (path.as_str(), value.as_str())).collect();
    let text = locate::all_replaced(source.text(), &pairs);
    let text = text.map_err(|(number, problem)| path_error(pairs[number].0, &problem))?;
    Ok(SourceText::new(source.path(), text))
}

/// The changed fields of the target, as text of a target file; `None` without changes.
///
/// # Errors
/// `set.path`.
pub fn target_fields() -> Result<Option<String>> {
    let mut changes = changes(Some("target"));
    for (path, _) in &mut changes {
        // A name that is not a limit of a resource is a pool's.
        if let Some(name) = path.strip_prefix("limits.")
            && !(name.contains('.') || name == "pools" || Limits::NAMES.contains(&name))
        {
            *path = format!("limits.pools.{name}");
        }
    }
    let text = with_parents("Target()", &changes)
        .map_err(|(number, message)| path_error(&format!("target.{}", changes[number].0), &message))?;
    let fields = text.strip_prefix("Target(").and_then(|text| text.strip_suffix(')'));
    Ok(fields.filter(|_| !changes.is_empty()).map(str::to_string))
}

/// Sets the value at each path and adds absent parents.
fn with_parents(text: &str, changes: &[(String, String)]) -> Result<String, (usize, String)> {
    let mut text = text.to_string();
    for (number, (path, _)) in changes.iter().enumerate() {
        for (at, _) in path.match_indices('.') {
            let parent = &path[..at];
            if locate::value(&text, parent).is_none() {
                text = locate::replaced(&text, parent, "()").map_err(|message| (number, message))?;
            }
        }
    }
    let pairs: Vec<(&str, &str)> = changes.iter().map(|(path, value)| (path.as_str(), value.as_str())).collect();
    locate::all_replaced(&text, &pairs)
}

/// Replaces the constants that are set.
///
/// # Errors
/// `set.path`, `set.value`.
pub fn constants(constants: &mut Constants) -> Result<()> {
    for (path, value) in changes(Some("constants")) {
        let constant = constants
            .get_mut(&path)
            .ok_or_else(|| path_error(&format!("constants.{path}"), "there is no such constant"))?;
        let number = constant.unit.parsed(&value).map_err(|message| {
            let help = format!("write --set constants.{path}=NUMBER{}", constant.unit.suffix());
            Diagnostic::new("set.value", format!("--set constants.{path}={value}: {message}")).help(help)
        })?;
        if !(0.0..=1e9).contains(&number) {
            return Err(Diagnostic::new("set.value", format!("--set constants.{path}={value}: outside 0 to 1e9"))
                .help(format!("give a constant from 0 to 1e9 {}", constant.unit.suffix())));
        }
        constant.value = number.into();
        (constant.source, constant.status) = ("given on the command line".to_string(), Status::Assumed);
        constant.findings.clear();
        constant.bounds = None;
        constants.borrowed.retain(|name| *name != path);
        constants
            .stated_in
            .extend(Constants::NAMES.iter().find(|name| **name == path).map(|name| (*name, SET_OPTION.into())));
        constants.forget_errors(classes_of(&path));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parents_are_made_where_they_are_absent() {
        let change = |path: &str, value: &str| (path.to_string(), value.to_string());
        let mut changes = vec![change("limits.axons_out", "8192")];
        assert_eq!(with_parents("Target()", &changes).unwrap(), "Target( limits: ( axons_out: 8192))");
        changes.extend([change("limits.axons_in", "7"), change("chips_x", "2")]);
        let three = "Target( limits: ( axons_out: 8192, axons_in: 7), chips_x: 2)";
        assert_eq!(with_parents("Target()", &changes).unwrap(), three);
        assert_eq!(with_parents(three, &[change("chips_x.y", "2")]).unwrap_err().0, 0);
    }

    #[test]
    fn a_thread_s_changes_end_with_its_work() {
        let read = || model(SourceText::new("m", "Network(a: 1, b: 2)")).unwrap().text().to_string();
        let changed = with_changes(&[Change::new("a", "5"), Change::new("target.x", "7")], read);
        assert_eq!((changed.as_str(), read().as_str()), ("Network(a: 5, b: 2)", "Network(a: 1, b: 2)"));
        let of_target = with_changes(&[Change::new("target.x", "7")], target_fields).unwrap();
        assert_eq!((of_target.as_deref(), target_fields().unwrap()), (Some(" x: 7"), None));
    }

    #[test]
    fn two_paths_of_one_field_are_refused() {
        let read = || model(SourceText::new("m", r#"Network(populations: [Loihi(name: "out", du: 1)])"#));
        for paths in [["populations.out.du", "populations.0.du"], ["populations.out.du", "populations"]] {
            let changes = [Change::new(paths[0], "5"), Change::new(paths[1], "6")];
            assert_eq!(with_changes(&changes, read).unwrap_err().code, "set.path", "{paths:?}");
        }
        let again = ["5", "6"].map(|value| Change::new("populations.out.du", value));
        assert!(with_changes(&again, read).unwrap().text().contains("du: 6"));
    }

    #[test]
    fn a_path_that_ends_nowhere_and_a_value_that_is_none_are_refused() {
        for path in ["target", "constants", "target.", "constants.", ".x", "a..b", "a.", "", " . "] {
            assert_eq!(Change::new(path, "1").check().unwrap_err().code, "set.path", "{path}");
        }
        for value in ["nonsense(", "1, dv: 2", ")", "1) //", "[1", "\"a"] {
            assert_eq!(Change::new("a", value).check().unwrap_err().code, "set.value", "{value}");
        }
        for value in ["1", "-0.5", "0.4us", "\"a, b\"", "[1, [2]]", "Npy(\"a.npy\")", "GreatestV"] {
            Change::new("a", value).check().unwrap();
        }
    }

    #[test]
    fn what_is_no_path_and_value_is_refused() {
        for wrong in ["a", "=1", "a=", "a= "] {
            assert!(set(&[wrong.to_string()]).unwrap_err().contains("PATH=VALUE"), "{wrong}");
        }
    }
}
