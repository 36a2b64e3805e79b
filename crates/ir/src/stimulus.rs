//! Syntax of a stimulus argument: `POPULATION=SOURCE`, or SOURCE alone.
//!
//! Module `nsim_import::spikes` reads the files, and `nsim_scene` makes the synthetic spikes.

use std::path::PathBuf;

use crate::base::diagnostic::{Diagnostic, Result};

/// A parsed `--input` argument.
#[derive(Debug, Clone, PartialEq)]
pub struct InputArg {
    /// Name of the input population; `None` where the argument gives none.
    pub population: Option<String>,
    /// Source of its spikes.
    pub source: InputSource,
}

/// A source of input spikes.
#[derive(Debug, Clone, PartialEq)]
pub enum InputSource {
    /// A file or folder, whose format is detected from its content. `-` is stdin.
    Path(PathBuf),
    /// A file or folder with options, `FILE?key=value&..`.
    Events(PathBuf, Vec<(String, String)>),
    /// `scene:NAME?key=value&..`
    Scene(SceneArg),
}

/// A synthetic scene and its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneArg {
    /// The scene's name.
    pub name: String,
    /// Names and values of its parameters, in the order given.
    pub parameters: Vec<(String, String)>,
}

/// Parses `key=value` pairs joined by `&`; empty pairs are ignored.
///
/// # Errors
/// `input.scene-syntax` for a pair without `=`.
pub fn pairs(query: &str) -> Result<Vec<(String, String)>> {
    query
        .split('&')
        .filter(|pair| !pair.is_empty())
        .map(|pair| match pair.split_once('=') {
            Some((key, value)) => Ok((key.to_string(), value.to_string())),
            None => Err(Diagnostic::new("input.scene-syntax", format!("parameter '{pair}' has no value"))
                .help("write scene:NAME?samples=20&seed=1")),
        })
        .collect()
}

impl SceneArg {
    /// Parses `NAME?key=value&key=value`.
    ///
    /// # Errors
    /// `input.scene-syntax` for a parameter without `=`.
    pub fn parse(text: &str) -> Result<Self> {
        let (name, query) = text.split_once('?').unwrap_or((text, ""));
        Ok(SceneArg { name: name.to_string(), parameters: pairs(query)? })
    }

    /// The scene as a command-line argument, `scene:NAME?key=value&..`.
    pub fn spelled(&self) -> String {
        let mut text = format!("scene:{}", self.name);
        for (i, (key, value)) in self.parameters.iter().enumerate() {
            text.push(if i == 0 { '?' } else { '&' });
            text.push_str(&format!("{key}={value}"));
        }
        text
    }
}

impl InputArg {
    /// Parses an `--input` argument. A `=` names a population only before any `/`, `?`, `:` or `.`.
    ///
    /// # Errors
    /// `input.scene-syntax` for a malformed scene.
    pub fn parse(text: &str) -> Result<Self> {
        let (population, source) = match text.split_once('=') {
            Some((name, rest)) if !name.is_empty() && !name.contains(['/', '?', ':', '.']) => {
                (Some(name.to_string()), rest)
            }
            _ => (None, text),
        };
        let source = match source.strip_prefix("scene:") {
            Some(scene) => InputSource::Scene(SceneArg::parse(scene)?),
            None => match source.rsplit_once('?') {
                Some((file, query)) if !file.is_empty() && query.split('&').all(|pair| pair.contains('=')) => {
                    InputSource::Events(file.into(), pairs(query)?)
                }
                _ => InputSource::Path(source.into()),
            },
        };
        Ok(InputArg { population, source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_parse() {
        let arg = InputArg::parse("touch=a/b=c.npy").unwrap();
        assert_eq!((arg.population.as_deref(), arg.source), (Some("touch"), InputSource::Path("a/b=c.npy".into())));
        let arg = InputArg::parse("./x=y.npy").unwrap();
        assert_eq!((arg.population, arg.source), (None, InputSource::Path("./x=y.npy".into())));
        let InputSource::Scene(scene) = InputArg::parse("scene:slip?samples=3&seed=9").unwrap().source else {
            panic!()
        };
        assert_eq!(scene.spelled(), "scene:slip?samples=3&seed=9");
        assert!(InputArg::parse("scene:slip?samples").is_err());
        let arg = InputArg::parse("eye=rec/a.raw?pool=4&crop=0,0,8,8").unwrap();
        let pairs = vec![("pool".to_string(), "4".to_string()), ("crop".to_string(), "0,0,8,8".to_string())];
        assert_eq!(
            (arg.population.as_deref(), arg.source),
            (Some("eye"), InputSource::Events("rec/a.raw".into(), pairs))
        );
    }
}
