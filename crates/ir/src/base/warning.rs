//! Warnings: what a user should check about a result that is given all the same.
//!
//! A warning is one record that text, JSON, Python and the page show: a change of the model, an
//! assumption of a reader, or a finding about a run. What is only of interest is a note.

/// A finding that a user should check.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Warning {
    /// Its kind, such as `silent-population` or `reset-assumed`.
    pub code: &'static str,
    /// The population that it is about; none for the whole network.
    pub population: Option<String>,
    /// The observation, and the advised change.
    pub message: String,
}

impl Warning {
    /// A warning about a whole network.
    pub fn of_network(code: &'static str, message: impl Into<String>) -> Self {
        Warning { code, population: None, message: message.into() }
    }

    /// A warning about a population.
    pub fn of_population(code: &'static str, population: &str, message: impl Into<String>) -> Self {
        Warning { code, population: Some(population.to_string()), message: message.into() }
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.population {
            Some(population) => write!(f, "'{population}': {}", self.message),
            None => f.write_str(&self.message),
        }
    }
}
