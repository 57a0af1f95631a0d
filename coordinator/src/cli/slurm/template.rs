//! Script templates with `{{NAME}}` placeholders.
//!
//! A line with a placeholder that has no value is left out. Values are quoted for the reader of
//! the line: Slurm if the line begins with `#SBATCH`, else the shell. A placeholder with several
//! values repeats an `#SBATCH` line, and becomes several words of a shell line.

/// Values of the placeholders.
#[derive(Default)]
pub(super) struct Values(Vec<(&'static str, Vec<String>)>);

impl Values {
    pub(super) fn set(&mut self, name: &'static str, value: impl ToString) {
        self.set_all(name, [value.to_string()]);
    }

    /// Sets none, one or several values.
    pub(super) fn set_all(&mut self, name: &'static str, values: impl IntoIterator<Item = String>) {
        self.0.push((name, values.into_iter().collect()));
    }

    fn get(&self, name: &str) -> &[String] {
        let entry = self.0.iter().find(|(placeholder, _)| *placeholder == name);
        &entry.unwrap_or_else(|| panic!("placeholder {{{{{name}}}}} of a template was never set")).1
    }
}

/// Fills a template in.
///
/// # Panics
/// If the template names a placeholder that was never set.
pub(super) fn fill(template: &str, values: &Values) -> String {
    let lines = template.lines().flat_map(|line| {
        let names = placeholders(line);
        if names.iter().any(|name| values.get(name).is_empty()) {
            return Vec::new();
        }
        if !line.starts_with("#SBATCH") {
            let words = |name: &str| {
                let words = values.get(name).iter().map(|value| for_shell(value));
                words.collect::<Vec<_>>().join(" ")
            };
            return vec![fill_line(line, &words)];
        }
        let repetitions = names.iter().map(|name| values.get(name).len()).max();
        let sbatch_line = |repetition: usize| {
            fill_line(line, &|name| {
                let values = values.get(name);
                for_slurm(&values[repetition.min(values.len() - 1)])
            })
        };
        (0..repetitions.unwrap_or(1)).map(sbatch_line).collect()
    });
    lines.map(|line| line + "\n").collect()
}

fn placeholders(line: &str) -> Vec<&str> {
    let parts = line.split("{{").skip(1);
    parts.filter_map(|part| part.split_once("}}").map(|(name, _)| name)).collect()
}

fn fill_line(line: &str, value: &dyn Fn(&str) -> String) -> String {
    let mut parts = line.split("{{");
    let mut filled = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        match part.split_once("}}") {
            Some((name, rest)) => {
                filled.push_str(&value(name));
                filled.push_str(rest);
            }
            None => filled.push_str(part),
        }
    }
    filled
}

/// Quotes a value as one word of the shell.
pub(super) fn for_shell(value: &str) -> String {
    if is_plain(value) { value.to_owned() } else { format!("'{}'", value.replace('\'', r"'\''")) }
}

/// Quotes a value as one word of an `#SBATCH` line, where a backslash escapes the next character,
/// also between quotation marks.
fn for_slurm(value: &str) -> String {
    match is_plain(value) {
        true => value.to_owned(),
        false => format!("\"{}\"", value.replace('\\', r"\\").replace('"', "\\\"")),
    }
}

/// Returns true if a value needs quotation marks neither for the shell nor for Slurm.
fn is_plain(value: &str) -> bool {
    let is_plain_char = |c: char| c.is_ascii_alphanumeric() || "_-+=:,./@%".contains(c);
    !value.is_empty() && value.chars().all(is_plain_char)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values() -> Values {
        let mut values = Values::default();
        values.set("folder", "/home/me/a \"b\" 'c'\\d");
        values.set_all("options", ["--qos=x".to_owned(), "--comment=a b".to_owned()]);
        values.set_all("nothing", []);
        values.set("number", 7);
        values
    }

    #[test]
    fn values_are_quoted_for_the_shell_or_for_slurm() {
        let template = "#SBATCH --chdir={{folder}}\ncd {{folder}} && sleep {{number}}\n";
        let expected = "#SBATCH --chdir=\"/home/me/a \\\"b\\\" 'c'\\\\d\"\n\
                        cd '/home/me/a \"b\" '\\''c'\\''\\d' && sleep 7\n";
        assert_eq!(fill(template, &values()), expected);
    }

    #[test]
    fn a_line_without_a_value_is_left_out_and_several_values_repeat_sbatch_lines() {
        let template = "#SBATCH {{options}}\n#SBATCH --x={{nothing}}\nrun {{options}} # all\n\
                        run {{number}} {{nothing}}\n";
        let expected = "#SBATCH --qos=x\n#SBATCH \"--comment=a b\"\n\
                        run --qos=x '--comment=a b' # all\n";
        assert_eq!(fill(template, &values()), expected);
    }
}
