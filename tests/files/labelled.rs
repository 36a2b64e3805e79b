//! Recordings in common forms: arrays with labels next to them, archives, event lists with a
//! header.

use std::path::Path;

use crate::common::command::said;
use crate::recordings::npz;
use serde_json::Value;

const MODEL: &str = "Network(name: \"m\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [2, 2, 3]),
    Loihi(name: \"out\", shape: [2], du: 4095, dv: 4095, vth_mant: 8)],
  projections: [Dense(from: [\"in\"], to: \"out\", weights: Uniform(low: 20, high: 60, step: 2, seed: 1))], output: \
                               \"out\")";

fn run(folder: &Path, args: &[&str]) -> (i32, Value) {
    let (status, printed, _) = said(folder, &[&["run", "m.ron", "--format", "json"], args].concat());
    (status, serde_json::from_str(&printed).unwrap())
}

fn npy(shape: &[u64], numbers: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    nsim::files::npy::write(&mut bytes, shape, numbers.iter().copied()).unwrap();
    bytes
}

#[test]
fn labels_lie_beside_an_array_or_within_an_archive() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let put = |name: &str, bytes: &[u8]| std::fs::write(here.join(name), bytes).unwrap();
    put("m.ron", MODEL.as_bytes());
    let spikes: Vec<u8> = (0..3 * 12 * 5).map(|at| u8::from(at % 4 == 0)).collect();
    put("x.npy", &npy(&[3, 12, 5], &spikes));
    put("y.npy", &npy(&[3], &[1, 0, 1]));
    put("short.npy", &npy(&[2], &[1, 0]));
    put("both.npz", &npz(&[("x.npy", &npy(&[3, 12, 5], &spikes)), ("y.npy", &npy(&[3], &[1, 0, 1]))]));
    let (status, plain) = run(here, &["--input", "x.npy"]);
    assert_eq!((status, &plain["labels"]), (0, &Value::Null));
    for input in [
        &["--input", "x.npy", "--labels", "y.npy"][..],
        &["--input", "in=x.npy?labels=y.npy"],
        &["--input", "both.npz"],
    ] {
        let (status, labelled) = run(here, input);
        assert_eq!((status, &labelled["labels"]), (0, &serde_json::json!([1, 0, 1])), "{input:?}");
        assert!(labelled["accuracy"].is_number(), "{labelled}");
        assert_eq!(labelled["activity"], plain["activity"], "{input:?}");
    }
    let (status, error) = run(here, &["--input", "x.npy", "--labels", "short.npy"]);
    assert_eq!((status, &error["code"]), (3, &"input.labels".into()));
    assert_eq!(run(here, &["--input", "scene:noise", "--labels", "y.npy"]).0, 2);
}

#[test]
fn event_lists_say_their_columns() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let put = |name: &str, text: &str| std::fs::write(here.join(name), text).unwrap();
    put("m.ron", MODEL);
    put("a.csv", "t,x,y,p\n0,0,0,1\n1500,2,1,0\n3000,1,1,1\n");
    put("b.csv", "# by hand\np,y,x,t_ms\n1,0,0,0\n-1,1,2,1.5\n1,1,1,3\n");
    let (status, first) = run(here, &["--input", "a.csv"]);
    assert_eq!(status, 0, "{first}");
    assert_eq!((&first["inputs"][0]["spikes"], &first["timesteps"]), (&3.into(), &4.into()), "{first}");
    let (_, second) = run(here, &["--input", "b.csv"]);
    assert_eq!((&second["activity"], &second["digest"]), (&first["activity"], &first["digest"]));
    put("c.csv", "t,x,y\n0,0,0\n1,1\n");
    let (status, error) = run(here, &["--input", "c.csv"]);
    assert!(status == 3 && error["message"].as_str().unwrap().contains("row 3"), "{error}");
}
