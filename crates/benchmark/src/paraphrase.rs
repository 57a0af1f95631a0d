//! Paraphrases of the canonical instructions: ten variants of every task at
//! three levels, 1,200 sentences. Variant j belongs to configuration j; `expansion`
//! puts it into the row.
//!
//! The sentences are this project's own. Like the presets of the metric axes,
//! variant j is the same change in every task, and the levels are cumulative by
//! construction, because each level keeps the choices of the level below:
//!
//! - **L1, vocabulary**: the task's construction in its canonical word order,
//!   with variant j of every verb, noun and preposition.
//! - **L2, local structure**: the same words in structure j of the construction
//!   (relative clauses, fronted places, changed attachments and word orders).
//! - **L3, frame**: the same words in the same structure inside frame j
//!   (question, need, goal, subordinate clause), which sets the verbs' form.
//!
//! Words, structures, frames and tasks are in `data/paraphrases.json`, which
//! also documents the syntax of its templates. To add a task, name its
//! construction there and fill the construction's slots from `words`; a new
//! construction needs its canonical order and ten structures. A word may only
//! replace another if it names its object uniquely in the scenes of all tasks that
//! use the list. Proofread all new sentences.
//!
//! The orthography is that of LIBERO's instructions: lower case, no final
//! punctuation, not even for questions. Commas within the sentence are allowed.

mod rules;
mod speech;

use crate::level::Level;
use crate::suite::TaskRef;
use rules::{Form, VARIANTS, rules};
use speech::Renderer;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Paraphrase {
    /// The policy's instruction, verbatim: lower-case English without final
    /// punctuation, at most 160 characters.
    pub text: String,
    /// Name in manifests: `t0/L1/v01` is variant 1 of task 0 of the row's suite at L1,
    /// `t0/L0/canonical` the task's own instruction.
    pub variant_id: String,
}

/// Returns the paraphrase of a task's instruction at `level` in configuration `config`. The
/// result is deterministic; at L0, the placebo level, it is the canonical instruction.
///
/// # Panics
/// If `level` is neither L0 nor one of [`Level::PERTURBED`], or, at a level other than L0, `config`
/// is not below [`PRESETS`](crate::presets::PRESETS).
pub fn paraphrase(task: TaskRef, level: Level, config: u16) -> Paraphrase {
    if level == Level::L0 {
        return Paraphrase {
            text: task.instruction(),
            variant_id: format!("t{}/{level}/canonical", task.index()),
        };
    }
    let variant = usize::from(config);
    assert!(variant < VARIANTS, "no paraphrase {config}: valid are 0 to 9");
    Paraphrase {
        text: sentence(task, level, variant),
        variant_id: format!("t{}/{level}/v{config:02}", task.index()),
    }
}

fn sentence(task: TaskRef, level: Level, variant: usize) -> String {
    let rules = rules();
    let task = &rules.tasks[&task];
    let construction = &rules.constructions[&task.construction];
    let renderer = Renderer::new(rules, task, variant);
    let structure = &construction.structures[variant];
    let (lead, body) = structure.split_once('|').unwrap_or(("", structure));
    let text = match level {
        Level::L1 => renderer.render(&construction.plain, Form::Base),
        Level::L2 => renderer.render(&format!("{lead}{body}"), Form::Base),
        Level::L3 => {
            let frame = &rules.frames[variant];
            let before = renderer.render(&frame.before.replace("{lead}", lead), Form::Base);
            format!("{before} {}", renderer.render(body, frame.form))
        }
        other => panic!("no paraphrase at {other}: valid are L1, L2, L3"),
    };
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::rules::Task;
    use super::*;

    fn variants() -> impl Iterator<Item = (TaskRef, usize)> {
        TaskRef::all().flat_map(|task| (0..VARIANTS).map(move |variant| (task, variant)))
    }

    /// Returns the lists of words and verbs that a template uses, directly or through slots.
    fn lists(task: &'static Task, template: &'static str) -> BTreeSet<&'static str> {
        let rules = rules();
        let construction = &rules.constructions[&task.construction];
        let mut lists = BTreeSet::new();
        for mark in template.split(['{', '<', '@']).skip(1) {
            let (mark, _) = mark.split_once(['}', '>', '@']).unwrap_or((mark, ""));
            let name = mark.trim_end_matches(" it").split('+').next().unwrap_or(mark);
            let slots = [&task.slots, &construction.defaults];
            if let Some(slot) = slots.into_iter().find_map(|slots| slots.get(name)) {
                lists.append(&mut self::lists(task, slot));
            } else if name.trim() == "put" {
                lists.insert(task.put.as_deref().expect("a verb for `put`"));
            } else {
                lists.insert(name.trim());
            }
        }
        lists
    }

    #[test]
    fn every_level_uses_the_vocabulary_of_l1() {
        let rules = rules();
        for (task, variant) in variants() {
            let task_rules = &rules.tasks[&task];
            let plain = &rules.constructions[&task_rules.construction].plain;
            for level in Level::PERTURBED {
                let text = sentence(task, level, variant);
                for list in lists(task_rules, plain) {
                    let is_used = match (rules.verbs.get(list), rules.words.get(list)) {
                        (Some(verbs), None) => verbs
                            .entry(variant)
                            .split('/')
                            .any(|form| form.split('~').all(|part| text.contains(part))),
                        (None, Some(words)) => text.contains(words.entry(variant)),
                        _ => panic!("`{list}` is not the name of exactly one list"),
                    };
                    assert!(is_used, "`{text}` uses nothing of `{list}`");
                }
            }
        }
    }

    #[test]
    fn a_frame_changes_only_the_form_of_verbs() {
        let rules = rules();
        let forms = rules.verbs.values().flat_map(|verbs| {
            (0..VARIANTS).flat_map(|variant| verbs.entry(variant).split(['/', '~', ' ']))
        });
        let forms: BTreeSet<&str> = forms.collect();
        for (task, variant) in variants() {
            let [l2, l3] = [Level::L2, Level::L3].map(|level| sentence(task, level, variant));
            let frame = &rules.frames[variant];
            let frame_words = frame.before.replace("{lead}", "");
            let unframed = l3.replacen(&format!("{} ", frame_words.trim()), "", 1);
            let [l2, l3]: [Vec<&str>; 2] = [&l2, &unframed].map(|text| text.split(' ').collect());
            assert_eq!(l2.len(), l3.len(), "{l2:?}, {l3:?}");
            for (below, above) in l2.iter().zip(&l3) {
                let inflected = frame.form != Form::Base
                    && [below, above]
                        .map(|word| word.trim_end_matches(','))
                        .iter()
                        .all(|word| forms.contains(word));
                assert!(below == above || inflected, "{below}, {above}: {l3:?}");
            }
        }
    }

    #[test]
    fn a_structure_with_a_lead_has_a_frame_with_a_place_for_it() {
        let rules = rules();
        for (name, construction) in &rules.constructions {
            for (structure, frame) in construction.structures.iter().zip(&rules.frames) {
                let has_lead = frame.before.contains("{lead}");
                assert!(has_lead || !structure.contains('|'), "{name}: {structure}");
            }
        }
    }

    #[test]
    fn every_list_of_the_file_is_used() {
        let rules = rules();
        let mut used = BTreeSet::new();
        for task in rules.tasks.values() {
            let construction = &rules.constructions[&task.construction];
            for template in construction.structures.iter().chain([&construction.plain]) {
                used.append(&mut lists(task, template));
            }
        }
        for list in rules.verbs.keys().chain(rules.words.keys()) {
            assert!(used.contains(list.as_str()), "{list} is never used");
        }
        for name in rules.constructions.keys() {
            let is_used = rules.tasks.values().any(|task| task.construction == *name);
            assert!(is_used, "no task uses construction {name}");
        }
    }
}
