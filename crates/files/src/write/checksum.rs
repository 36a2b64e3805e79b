//! Checksums of files that nsim reads again: results, training checkpoints, runs of a study.
//!
//! Input: a JSON object. Output: the object with the field [`FIELD`], the SHA-256 of the other
//! fields, or whether the field is right. White space is ignored, so other tools may reformat it.

use serde::{Serialize, Serializer};
use serde_json::{Map, Value};

use crate::text::sha256;
use nsim_ir::base::names::printable;

/// The field of the checksum.
pub const FIELD: &str = "checksum";
/// Fields with times of the run, which the checksum ignores, since they differ between equal
/// results.
const TIMES: [&str; 3] = ["wall_s", "us_per_timestep", "seconds"];

/// The fields of an object that its checksum covers.
struct Covered<'a>(&'a Map<String, Value>);

impl Serialize for Covered<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().filter(|(name, _)| *name != FIELD && !TIMES.contains(&name.as_str())))
    }
}

/// The checksum of an object's other fields.
pub fn checksum_of(object: &Value) -> String {
    let text = match object {
        Value::Object(fields) => serde_json::to_string(&Covered(fields)).unwrap_or_default(),
        other => other.to_string(),
    };
    // The checksum covers the printed form.
    sha256(printable(&text).as_bytes())
}

/// An object with its checksum.
pub fn with(mut object: Value) -> Value {
    object[FIELD] = checksum_of(&object).into();
    object
}

/// Results that `nsim report` and `nsim plot` read again.
const READ: [&str; 5] = ["nsim.agree/1", "nsim.bench/1", "nsim.energy/1", "nsim.map/1", "nsim.run/1"];

/// A result for printing and for Python; it has a checksum if nsim may read it again.
pub fn printed(result: Value) -> Value {
    let is_read = READ.iter().any(|schema| result["schema"] == *schema);
    if is_read { with(result) } else { result }
}

/// Whether an object has the checksum of its other fields; `None` when it has none.
pub fn holds(object: &Value) -> Option<bool> {
    Some(*object.get(FIELD)? == checksum_of(object))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_change_of_any_field_is_found_and_layout_is_not() {
        let sealed = with(json!({"a": 0.1, "b": [1, {"c": "d"}], "e": 1e300, "wall_s": 1.5}));
        assert_eq!(holds(&sealed), Some(true));
        for text in [sealed.to_string(), format!("{sealed:#}").replace('\n', "\r\n")] {
            assert_eq!(holds(&serde_json::from_str(&text).unwrap()), Some(true));
        }
        for (from, to) in [("0.1", "0.2"), ("\"d\"", "\"f\""), ("1e+300", "1e+301"), ("\"a\"", "\"g\"")] {
            let changed = sealed.to_string().replacen(from, to, 1);
            let read = serde_json::from_str::<Value>(&changed).unwrap_or_else(|error| panic!("{changed}: {error}"));
            assert_eq!(holds(&read), Some(false), "{changed}");
        }
        assert_eq!(holds(&json!({"a": 1})), None);
    }
}
