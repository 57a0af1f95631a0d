//! Renders templates of `data/paraphrases.json` into sentences.

use super::rules::{Form, Rules, Task};

/// Renders templates for one task with the words of one variant.
pub(super) struct Renderer<'r> {
    rules: &'r Rules,
    task: &'r Task,
    variant: usize,
}

impl<'r> Renderer<'r> {
    pub(super) fn new(rules: &'r Rules, task: &'r Task, variant: usize) -> Self {
        Self { rules, task, variant }
    }

    /// Renders a template. Verbs without a fixed form take `form`.
    ///
    /// # Panics
    /// If the template uses an undefined name or verb form, or does not close a mark.
    pub(super) fn render(&self, template: &str, form: Form) -> String {
        let mut text = String::new();
        let mut rest = template;
        while let Some((before, mark)) = rest.split_once(['{', '<']) {
            text.push_str(before);
            let is_verb = rest[before.len()..].starts_with('<');
            let (mark, after) = mark
                .split_once(if is_verb { '>' } else { '}' })
                .unwrap_or_else(|| panic!("unclosed mark in `{template}`"));
            text.push_str(&if is_verb { self.verb(mark, form) } else { self.name(mark, form) });
            rest = after;
        }
        text + rest
    }

    /// Renders a name: a slot of the task, of its construction or of its grammatical number,
    /// or a word.
    fn name(&self, name: &str, form: Form) -> String {
        let Self { rules, task, .. } = self;
        let construction = &rules.constructions[&task.construction];
        let slots = [&task.slots, &construction.defaults, &rules.numbers[&task.number]];
        if let Some(slot) = slots.into_iter().find_map(|slots| slots.get(name)) {
            return self.render(slot, form);
        }
        let words = rules.words.get(name).unwrap_or_else(|| panic!("no slot and no word `{name}`"));
        words.entry(self.variant).to_owned()
    }

    /// Renders a verb: `name`, then optionally `+` and a fixed form, and a space and the object.
    fn verb(&self, mark: &str, form: Form) -> String {
        let (name, rest) = self.verb_name(mark);
        let (fixed, object) = rest.split_once(' ').unwrap_or((rest, ""));
        let form = match fixed {
            "" => form,
            "+base" => Form::Base,
            "+ing" => Form::Gerund,
            "+ed" => Form::Participle,
            other => panic!("no verb form `{other}` in <{mark}>"),
        };
        let object = match object.strip_prefix('@') {
            Some(slot) => self.name(slot, form),
            None => object.to_owned(),
        };
        let verbs =
            self.rules.verbs.get(name).unwrap_or_else(|| panic!("no verb `{name}` in <{mark}>"));
        let forms = verbs.entry(self.variant);
        let verb = forms
            .split('/')
            .nth(form as usize)
            .unwrap_or_else(|| panic!("verb `{forms}` does not have three forms"));
        match verb.contains('~') {
            true => verb.replace('~', &format!(" {object} ")),
            false => format!("{verb} {object}").trim_end().to_owned(),
        }
    }

    /// Splits a mark into the name of a list of verbs and the text after the name. `put` stands
    /// for the list that the task names.
    fn verb_name<'m>(&self, mark: &'m str) -> (&'m str, &'m str)
    where
        'r: 'm,
    {
        if let (Some(put), Some(rest)) = (&self.task.put, mark.strip_prefix("put")) {
            return (put, rest);
        }
        // Names may contain spaces, so the longest known name that matches wins.
        let names = self.rules.verbs.keys();
        let name = names
            .filter_map(|name| Some((name.as_str(), mark.strip_prefix(name.as_str())?)))
            .filter(|(_, rest)| rest.is_empty() || rest.starts_with([' ', '+']));
        name.max_by_key(|(name, _)| name.len()).unwrap_or((mark, ""))
    }
}
