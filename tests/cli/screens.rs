//! Screens: the output of a command fits the columns of a terminal and breaks no word, and `-h` is
//! one screen.

use std::collections::BTreeSet;
use std::io::Read;
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::{MODEL, SRM, nsim, write};

/// Longest `-h`, in lines.
const HELP_LINES: usize = 30;

/// Commands on files that the tests write, about cores and energy. Figures of commands marked
/// `true` differ between runs.
const NETWORK: [(&str, bool); 9] = [
    ("map vtsnn-slip", true),
    ("map m.ron --target tiny --copies 3 --prune static", true),
    ("run vtsnn-slip --samples 0..2", true),
    ("run m.ron --input scene:noise?samples=14&steps=20&rate=0.3 --early-exit 1", true),
    ("energy m.ron --input scene:noise?samples=2&steps=20&rate=0.3 --baseline rtx-2080-ti", false),
    ("energy m.ron --input scene:noise?samples=2&steps=20&rate=0.3 --baseline rtx-2080-ti --full", false),
    ("energy m.ron --input scene:noise?samples=2&steps=20&rate=0.3 --baseline --accounting rails --full", false),
    ("compare m.ron --targets tiny,oheo-gulch --input scene:noise?samples=2&steps=20&rate=0.3", false),
    ("energy m.ron --input scene:noise?samples=2&steps=20&rate=0.3 --baseline --set constants.turn_time=0.4us", false),
];

/// Commands about the trained network and other tools.
const AGREEMENT: [(&str, bool); 5] = [
    ("agree srm.ron --input scene:noise?samples=4&steps=20&rate=0.3 --calibration-samples 2", false),
    ("agree srm.ron --input scene:noise?samples=4&steps=20&rate=0.3 --against c.ron --against c.ron", false),
    ("convert srm.ron --input scene:noise?samples=4&steps=20&rate=0.3", true),
    ("import net.nir", false),
    ("export m.ron -o net.nir --force", false),
];

/// Commands that print tables of many runs.
const STUDY: [(&str, bool); 6] = [
    ("bench step --network vtsnn-1pct --steps 2", true),
    ("bench pareto m.ron --input scene:noise?samples=2&steps=20&rate=0.3 --seconds 0.01", true),
    ("bench published --only smnist", false),
    ("bench paper", false),
    ("bench paper --full --stored", false),
    ("sweep sweep.ron -o table.csv --force", true),
];

/// Commands that describe models, chips, scenes and nsim itself.
const INSPECTION: [(&str, bool); 7] = [
    ("inspect nahuku-32", false),
    ("inspect loihi1-evidence", false),
    ("inspect vtsnn-slip", false),
    ("inspect rtx-2080-ti", false),
    ("scene slip --samples 2", false),
    ("scene container --samples 2", false),
    ("stress --case weight-exponent-least thresholds-at-both-ends denormals-f64", false),
];

/// The output of a command in a terminal with this many columns.
fn printed(folder: &std::path::Path, words: &[&str], columns: usize) -> String {
    let output = nsim(words).current_dir(folder).env("COLUMNS", columns.to_string()).output().unwrap();
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Checks that each command fits its columns and breaks no word.
fn check_screens(screens: &[(&str, bool)]) {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "m.ron", MODEL);
    write(folder.path(), "srm.ron", SRM);
    write(folder.path(), "sweep.ron", "Sweep(model: \"m.ron\", input: [\"scene:noise?samples=1&steps=9&rate=0.3\"])");
    let ready = ["export m.ron -o net.nir", "convert srm.ron --input scene:noise?samples=4&steps=20&rate=0.3 -o c.ron"];
    for line in ready {
        printed(folder.path(), &line.split(' ').collect::<Vec<_>>(), 80);
    }
    for &(line, timed) in screens {
        let words: Vec<&str> = line.split(' ').collect();
        let parts = |text: &str| -> BTreeSet<String> {
            let all = text.split_whitespace().filter(|word| !timed || word.contains(char::is_alphabetic));
            all.map(str::to_string).collect()
        };
        let whole = parts(&printed(folder.path(), &words, 10_000));
        for columns in [80, 120] {
            let screen = printed(folder.path(), &words, columns);
            let widest = screen.lines().max_by_key(|line| line.chars().count()).unwrap();
            assert!(widest.chars().count() <= columns, "nsim {line} at {columns} columns: {widest}");
            assert_eq!(parts(&screen), whole, "nsim {line} at {columns} columns: {screen}");
        }
    }
}

#[test]
fn cores_and_energy_fit_their_columns_and_break_no_word() {
    check_screens(&NETWORK);
}

#[test]
fn agreement_and_other_tools_fit_their_columns_and_break_no_word() {
    check_screens(&AGREEMENT);
}

#[test]
fn studies_fit_their_columns_and_break_no_word() {
    check_screens(&STUDY);
}

#[test]
#[ignore = "takes minutes: in .ci/nightly"]
fn all_published_works_fit_their_columns_and_break_no_word() {
    check_screens(&[("bench published", false)]);
}

#[test]
fn inspection_fits_its_columns_and_lines_and_breaks_no_word() {
    check_screens(&INSPECTION);
    let lines = |name| printed(std::path::Path::new("."), &["inspect", name], 80).lines().count();
    assert!(lines("nahuku-32") <= 40 && lines("vtsnn-slip") <= 40);
}

/// What a terminal shows while a command runs, and the time of its first character.
fn in_a_terminal(line: &str) -> (String, Duration) {
    let program = assert_cmd::cargo::cargo_bin("nsim");
    let command = format!("{} {line} > /dev/null", program.display());
    let begun = Instant::now();
    let mut terminal = std::process::Command::new("script")
        .args(["-qefc", &command, "/dev/null"])
        .env("TERM", "xterm")
        .env_remove("NO_COLOR")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut out = terminal.stdout.take().unwrap();
    let mut screen = vec![0];
    out.read_exact(&mut screen).unwrap();
    let after = begun.elapsed();
    out.read_to_end(&mut screen).unwrap();
    let screen = String::from_utf8(screen).unwrap();
    assert!(terminal.wait().unwrap().success(), "{line}: {screen}");
    (screen, after)
}

#[test]
#[cfg(target_os = "linux")]
fn a_terminal_shows_the_stage_of_a_command_and_clears_it_and_a_pipe_shows_nothing() {
    let line = "run --input scene:slip?samples=200";
    let (screen, after) = in_a_terminal(line);
    assert!(screen.contains("nsim run") || screen.contains("reading or making samples"), "{screen:?}");
    assert!(screen.contains("samples ["), "a bar: {screen:?}");
    // Half a second on a free machine.
    assert!(after < Duration::from_secs(5), "{after:?}");
    let left = screen.rsplit("\u{1b}[2K").next().unwrap();
    assert_eq!(left.trim(), "", "{screen:?}");
    let piped = nsim(&line.split(' ').collect::<Vec<_>>()).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&piped.stderr), "");
}

#[test]
fn short_help_is_a_screen_and_long_help_has_every_option() {
    let root = printed(std::path::Path::new("."), &["-h"], 80);
    assert!(root.lines().count() <= HELP_LINES, "nsim -h: {}\n{root}", root.lines().count());
    let names = root.lines().filter_map(|line| line.strip_prefix("  ")?.split("  ").next());
    let commands: Vec<&str> = names.take_while(|name| !name.starts_with('-')).filter(|name| !name.is_empty()).collect();
    assert!(commands.len() > 16, "{root}");
    let below = ["bench map", "bench step", "bench pareto", "bench published", "bench sweep"];
    for command in commands.into_iter().chain(below) {
        let words: Vec<&str> = command.split(' ').collect();
        let help = |option| printed(std::path::Path::new("."), &[&words[..], &[option]].concat(), 80);
        let (short, long) = (help("-h"), help("--help"));
        assert!(short.lines().count() <= HELP_LINES, "nsim {command} -h: {}\n{short}", short.lines().count());
        assert!(short.contains("EXAMPLES:") && short.contains("--help"), "{short}");
        assert!(long.contains("Options of every command:") && long.len() > short.len(), "{long}");
        assert!([short, long].iter().all(|help| help.lines().all(|line| line.chars().count() <= 80)), "{command}");
    }
}
