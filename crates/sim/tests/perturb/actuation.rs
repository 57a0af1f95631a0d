use benchmark::streams::Randomness;
use benchmark::{Axis, Realisation, RolloutId, Suite};
use sim::perturb::ActuationStage;

use crate::reference::{arrays, check_close, folder, presets};

#[test]
fn action_sequences_of_all_presets_equal_the_reference() {
    let Some(folder) = folder("perturb") else {
        return;
    };
    let arrays = arrays(&folder.join("actuation.npz"));
    let actions: Vec<[f64; 7]> =
        arrays["actions"].chunks_exact(7).map(|action| action.try_into().expect("seven")).collect();
    for suite in Suite::ALL {
        for (level, config, perturbation) in presets(Axis::Actuation) {
            // The reference names the second of them `combination`.
            for (condition, published) in
                [("actuation", "actuation"), ("simultaneous", "combination")]
            {
                let short = suite.short_name();
                let id = format!("{short}/t0/{condition}/{level}/c{config:02}");
                let id: RolloutId = id.parse().expect("an id");
                let mut stage = ActuationStage::new(
                    &perturbation.actuation.expect("set"),
                    suite.demo_action_rms(),
                    &Randomness::of(&id, Axis::Actuation, Realisation::Reference),
                );
                let outputs = actions.iter().flat_map(|action| stage.apply(action));
                let key = format!("{short}_{published}_{level}_c{config:02}");
                let outputs: Vec<f64> = outputs.collect();
                check_close(&outputs, &arrays[&key], 1e-12, &key);
            }
        }
    }
}
