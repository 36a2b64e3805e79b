//! The examples of `docs/formats.md` are valid: each is read by the reader of its format.

use std::path::Path;

use nsim::files::lower::lower;
use nsim::files::shipped::Origin;
use nsim::files::target;
use nsim::import::model;
use nsim::import::spikes;
use nsim::import::spikes::manifest;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::mapping::MappingFile;
use nsim::ir::spanned::parse;
use nsim::quantise::quantise::quantise;

/// The fenced blocks of a language, each with its line number.
fn blocks(language: &str) -> Vec<(SourceText, String)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/formats.md");
    let text = std::fs::read_to_string(&path).expect("the project has docs/formats.md");
    let fence = format!("```{language}\n");
    text.match_indices(&fence)
        .map(|(at, _)| {
            let start = at + fence.len();
            let block = &text[start..start + text[start..].find("```").expect("a fence is closed")];
            let line = text[..start].lines().count() + 1;
            (SourceText::new(format!("docs/formats.md (from line {line})"), block), block.to_string())
        })
        .collect()
}

#[test]
fn every_ron_example_is_read() {
    let mut kinds = Vec::new();
    for (source, text) in blocks("ron") {
        let line = text.lines().find(|line| !line.starts_with("//")).unwrap();
        let root = line.split('(').next().unwrap().to_string();
        let result = match root.as_str() {
            "Network" => model::network(source, Origin::File).and_then(|network| quantise(&lower(&network)?)).map(drop),
            "Target" => target::target(&source, Origin::File).map(drop),
            "Chip" => target::parse_chip(&source).map(drop),
            "Mapping" => parse::<MappingFile>(&source, "mapping.syntax").map(drop),
            "DataSet" => manifest::from_source(source).map(drop),
            other => panic!("nothing reads {other}"),
        };
        result.unwrap_or_else(|problem| panic!("{problem}"));
        kinds.push(root);
    }
    kinds.sort();
    kinds.dedup();
    assert_eq!(kinds, ["Chip", "DataSet", "Mapping", "Network", "Target"]);
}

#[test]
fn the_csv_example_is_read() {
    let blocks = blocks("csv");
    let [(_, text)] = blocks.as_slice() else { panic!("one example") };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("e.csv");
    std::fs::write(&path, text).unwrap();
    let samples = spikes::csv::read(&path, 150).unwrap();
    assert_eq!((samples[0].steps, samples[0].events.clone()), (150, vec![(3, 17), (3, 18), (149, 0)]));
}

/// Each field of a model file is described: the reader's own list of fields, from its errors, is
/// compared with the text.
#[test]
fn every_field_of_a_model_is_described() {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/formats.md")).unwrap();
    let probes = [
        "Network(zz: 1)",
        "Network(populations: [Loihi(zz: 1)])",
        "Network(projections: [Dense(zz: 1)])",
        "Network(projections: [Conv2d(zz: 1)])",
        "Network(projections: [SumPool2d(zz: 1)])",
        "Network(projections: [Random(zz: 1)])",
        "Network(projections: [Sparse(zz: 1)])",
    ];
    let mut fields = 0;
    for probe in probes {
        let problem = model::network(SourceText::new("probe.ron", probe), Origin::File).unwrap_err();
        let (_, listed) = problem.message.split_once("write one of ").unwrap_or_else(|| panic!("{problem}"));
        for field in listed.split('`').skip(1).step_by(2) {
            assert!(text.contains(&format!("`{field}`")) || text.contains(&format!("`{field}:")), "{field}");
            fields += 1;
        }
    }
    assert!(fields > 40, "{fields} fields were listed");
}
