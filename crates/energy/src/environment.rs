//! The machine and the program that a figure was measured with.

use std::fmt;

use nsim_machine::lanes::width;

/// The machine and program on which a measured time depends.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Environment {
    /// The processor, as it names itself.
    pub cpu: String,
    /// Threads that can run simultaneously.
    pub cores: usize,
    /// Operating system and architecture.
    pub os: String,
    /// The compiler that built the program.
    pub rustc: &'static str,
    /// The program's version.
    pub nsim: &'static str,
    /// `release` or, when the program was built without optimisation, `debug`.
    pub profile: &'static str,
    /// The vectors that steps use.
    pub vectors: &'static str,
}

impl Environment {
    /// The environment of this process.
    pub fn here() -> Self {
        Environment {
            cpu: cpu().unwrap_or_else(|| "unknown".to_string()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            os: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            rustc: env!("NSIM_RUSTC"),
            nsim: env!("CARGO_PKG_VERSION"),
            profile: if cfg!(debug_assertions) { "debug" } else { "release" },
            vectors: width::name(),
        }
    }
}

impl fmt::Display for Environment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Environment { cpu, cores, os, rustc, nsim, profile, vectors } = self;
        write!(f, "{cpu}, {cores} cores, {vectors}, {os}; nsim {nsim} ({profile}), {rustc}")
    }
}

/// Returns the processor's name, which Linux has in a file; `None` elsewhere.
fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let field = |name: &str| {
        let line = text.lines().find(|line| line.split(':').next().map(str::trim) == Some(name))?;
        line.split_once(':').map(|(_, value)| value.trim().to_string())
    };
    // Virtual machines give a family of processors one name; family and model distinguish them.
    let name = field("model name")?;
    Some(match (field("cpu family"), field("model")) {
        (Some(family), Some(model)) => format!("{name} (family {family}, model {model})"),
        _ => name,
    })
}
