//! Compares both generators with values that NumPy drew, for every seed of the reference file.

use std::path::PathBuf;

use benchmark::numpy::{DefaultRng, LegacyRng};
use serde_json::Value;

fn reference(name: &str) -> Option<Value> {
    let path =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/oracle/perturb").join(name);
    match std::fs::read_to_string(&path) {
        Ok(text) => Some(serde_json::from_str(&text).expect("reference file is JSON")),
        Err(_) => {
            println!("skipped: {} is not here", path.display());
            None
        }
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    let items = value.as_array().expect("an array");
    items.iter().map(|x| x.as_f64().expect("a number")).collect()
}

#[test]
fn default_rng_equals_numpy_for_every_reference_seed() {
    let Some(reference) = reference("rng.json") else {
        return;
    };
    for (seed, expected) in reference["default_rng"].as_object().expect("seeds") {
        let seed: u64 = seed.parse().expect("an integer seed");
        let mut rng = DefaultRng::seed(seed);
        let normals: Vec<f64> = (0..6).map(|_| rng.standard_normal()).collect();
        assert_eq!(normals, numbers(&expected["normal6"]), "seed {seed}");
        let angle = rng.uniform(0.0, std::f64::consts::PI);
        assert_eq!(Some(angle), expected["uniform_pi"].as_f64(), "seed {seed}");
        let normals: Vec<f64> = (0..1000).map(|_| rng.standard_normal()).collect();
        assert_eq!(normals[995..], numbers(&expected["normal1000_tail"]), "seed {seed}");
    }
}

#[test]
fn legacy_rng_equals_numpy_for_every_reference_seed() {
    let Some(reference) = reference("rng.json") else {
        return;
    };
    for (seed, expected) in reference["legacy_mt19937"].as_object().expect("seeds") {
        let mut rng = LegacyRng::seed(seed.parse().expect("a 32-bit seed"));
        let normals: Vec<f64> = (0..7).map(|_| rng.randn()).collect();
        assert_eq!(normals, numbers(&expected["randn7"]), "seed {seed}");
        let uniforms: Vec<f64> = (0..4).map(|_| rng.uniform(-0.01, 0.01)).collect();
        assert_eq!(uniforms, numbers(&expected["uniform_after"]), "seed {seed}");
        let integers: Vec<f64> = (0..6).map(|_| f64::from(rng.randint(3))).collect();
        assert_eq!(integers, numbers(&expected["randint3"]), "seed {seed}");
        assert_eq!(rng.randint(1), 0);
        let reversed = rng.uniform(0.4, -0.2);
        assert_eq!(Some(reversed), expected["uniform_reversed"].as_f64());
        let samples: Vec<f64> = (0..3).map(|_| rng.random_sample()).collect();
        assert_eq!(samples, numbers(&expected["random_sample"]), "seed {seed}");
    }
}
