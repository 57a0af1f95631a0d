//! Compares LIBERO-Para with LIBERO and with the data of `benchmark::family`, in a checkout that
//! `ROLLOUT_PARA` names.

use std::fs;
use std::path::{Path, PathBuf};

use benchmark::family::para::{self, Paraphrase};
use benchmark::family::protocol::Benchmark;
use scene::{SceneError, Sources, TaskFiles, copy_paraphrases};
use tests::files::sources;

fn checkout(test: &str) -> Option<PathBuf> {
    let checkout = std::env::var_os("ROLLOUT_PARA").map(PathBuf::from);
    if checkout.is_none() {
        println!("skipped {test}: ROLLOUT_PARA names no checkout of LIBERO-Para");
    }
    checkout
}

/// Returns the checkout's BDDL file and initial states of a paraphrase.
fn released(checkout: &Path, paraphrase: &Paraphrase) -> TaskFiles {
    let package = checkout.join(para::PACKAGE);
    let states = format!("init_files/libero_para/eval{}.pruned_init", paraphrase.eval);
    TaskFiles { bddl: package.join(paraphrase.bddl_file()), init: package.join(states) }
}

fn read(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn files_of_all_sentences_equal_those_of_the_task_except_for_the_sentence() {
    let test = "files_of_all_sentences_equal_those_of_the_task_except_for_the_sentence";
    let Some(checkout) = checkout(test) else {
        return;
    };
    let sources = sources();
    let without_sentence = |path: &Path| -> Vec<String> {
        let text = String::from_utf8(read(path)).expect("UTF-8");
        let lines = text.lines().map(str::to_owned);
        let (sentences, others): (Vec<String>, _) =
            lines.partition(|line| line.trim_start().starts_with("(:language "));
        assert_eq!(sentences.len(), 1, "{}", path.display());
        others
    };
    let mut count = 0;
    for paraphrase in para::inventory() {
        let (found, task) =
            (released(&checkout, paraphrase), TaskFiles::of_task(&sources, paraphrase.task));
        assert_eq!(without_sentence(&found.bddl), without_sentence(&task.bddl), "{paraphrase}");
        assert_eq!(read(&found.init), read(&task.init), "{paraphrase}");
        count += 1;
    }
    assert_eq!(count, 4092);
    let folder = checkout.join(para::PACKAGE).join("bddl_files/libero_para");
    assert_eq!(fs::read_dir(folder).expect("a folder").count(), count);
}

#[test]
fn sentences_and_similarities_of_all_paraphrases_equal_the_metadata() {
    let test = "sentences_and_similarities_of_all_paraphrases_equal_the_metadata";
    let Some(checkout) = checkout(test) else {
        return;
    };
    let metadata = String::from_utf8(read(&checkout.join(para::METADATA))).expect("UTF-8");
    let mut lines: Vec<&str> = metadata.lines().skip(1).collect();
    lines.sort_unstable();
    let quoted = |sentence: String| match sentence.contains([',', '"']) {
        true => format!("\"{}\"", sentence.replace('"', "\"\"")),
        false => sentence,
    };
    let mut expected: Vec<(String, f64, f64)> = Vec::new();
    for paraphrase in para::inventory() {
        let Paraphrase { kind, task, .. } = paraphrase;
        let sentence = released(&checkout, paraphrase).sentence();
        let start = format!(
            "{},{},{},{},{},{},{}",
            kind.high(),
            kind.mid(),
            kind.low(),
            paraphrase.eval,
            paraphrase.number,
            quoted(sentence.expect("a sentence")),
            task.instruction(),
        );
        expected.push((start, paraphrase.structure, paraphrase.keywords));
    }
    let found = lines.into_iter().map(|line| {
        let mut fields = line.rsplitn(3, ',');
        let mut number = || -> f64 {
            let field = fields.next().expect("a field");
            field.parse().expect("a number")
        };
        let (keywords, structure) = (number(), number());
        (fields.next().expect("a field").to_owned(), structure, keywords)
    });
    let mut found: Vec<(String, f64, f64)> = found.collect();
    for all in [&mut expected, &mut found] {
        all.sort_by(|a, b| a.0.cmp(&b.0));
    }
    assert_eq!(found, expected);
}

/// Creates sources without task files.
fn empty_sources(folder: &Path) -> Sources {
    for inside in ["robosuite", "libero/bddl_files", "libero/init_files"] {
        fs::create_dir_all(folder.join(inside)).expect("a folder");
    }
    fs::write(folder.join("robosuite/base.xml"), "").expect("a file");
    Sources::open(folder).expect("sources")
}

#[test]
fn an_altered_or_incomplete_checkout_is_refused_with_the_fetch_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let sources = empty_sources(&folder.path().join("sources"));
    let checkout = folder.path().join("checkout");
    let refusal = |sources: &Sources| -> String {
        let error = copy_paraphrases(&checkout, sources).expect_err("refused");
        assert!(matches!(error, SceneError::Checkout { .. }), "{error}");
        assert!(!scene::has_task_files(Benchmark::Para, sources));
        error.to_string()
    };
    for words in ["4093 of 4093 files are missing", para::FETCH] {
        let problem = refusal(&sources);
        assert!(problem.contains(words), "{problem}");
    }
    let paths = para::inventory().iter().map(Paraphrase::bddl_file);
    let paths = paths.map(|path| checkout.join(para::PACKAGE).join(path));
    let mut paths: Vec<PathBuf> = paths.chain([checkout.join(para::METADATA)]).collect();
    for path in &paths {
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, "(:language another sentence)").expect("a file");
    }
    let problem = refusal(&sources);
    assert!(problem.contains(para::digest()), "{problem}");
    let metadata = paths.pop().expect("the metadata");
    fs::write(&metadata, vec![b' '; (4 << 20) + 1]).expect("a file");
    let problem = refusal(&sources);
    for words in [para::METADATA, "larger than 4 MiB"] {
        assert!(problem.contains(words), "{problem}");
    }
    fs::remove_file(metadata).expect("removed");
    let problem = refusal(&sources);
    assert!(problem.contains("1 of 4093 files are missing"), "{problem}");
}

#[test]
fn the_files_of_a_checkout_are_verified_and_copied() {
    let test = "the_files_of_a_checkout_are_verified_and_copied";
    let Some(checkout) = checkout(test) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let sources = empty_sources(folder.path());
    for _ in 0..2 {
        copy_paraphrases(&checkout, &sources).expect("copied");
        assert!(scene::has_task_files(Benchmark::Para, &sources));
    }
    for paraphrase in para::inventory() {
        let folder = Sources::family(sources.dir(), Benchmark::Para);
        let original = released(&checkout, paraphrase);
        assert_eq!(
            read(&folder.join(paraphrase.bddl_file())),
            read(&original.bddl),
            "{paraphrase}"
        );
    }
}
