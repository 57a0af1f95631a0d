//! A small ordered XML tree for reading, changing and writing MJCF. Comments and text are dropped;
//! the order of attributes is kept.

use std::fmt::Write as _;

/// An element with its attributes and children, in document order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Element {
    pub(crate) tag: String,
    attributes: Vec<(String, String)>,
    pub(crate) children: Vec<Element>,
}

/// Limit of nesting, beyond any real model; bounds the stack.
const MAX_DEPTH: usize = 128;

impl Element {
    pub(crate) fn new(tag: &str) -> Self {
        Self { tag: tag.to_owned(), attributes: Vec::new(), children: Vec::new() }
    }

    /// The message has the position of a syntax error, but not of one about nesting or namespaces.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let document = roxmltree::Document::parse(text).map_err(|error| error.to_string())?;
        Self::from_node(document.root_element(), 0)
    }

    fn from_node(node: roxmltree::Node<'_, '_>, depth: usize) -> Result<Self, String> {
        if depth == MAX_DEPTH {
            return Err(format!("elements are nested more than {MAX_DEPTH} deep"));
        }
        // A namespaced attribute would lose its prefix, and its name could then occur twice.
        if let Some(namespaced) = node.attributes().find(|a| a.namespace().is_some()) {
            return Err(format!("attribute `{}` is in a namespace", namespaced.name()));
        }
        let attributes =
            node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
        let children = node
            .children()
            .filter(roxmltree::Node::is_element)
            .map(|child| Self::from_node(child, depth + 1))
            .collect::<Result<_, _>>()?;
        Ok(Self { tag: node.tag_name().name().to_owned(), attributes, children })
    }

    pub(crate) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    pub(crate) fn set(&mut self, name: &str, value: impl Into<String>) {
        let value = value.into();
        match self.attributes.iter_mut().find(|(key, _)| key == name) {
            Some((_, old)) => *old = value,
            None => self.attributes.push((name.to_owned(), value)),
        }
    }

    pub(crate) fn set_default(&mut self, name: &str, value: &str) {
        if self.get(name).is_none() {
            self.set(name, value);
        }
    }

    pub(crate) fn remove(&mut self, name: &str) -> Option<String> {
        let index = self.attributes.iter().position(|(key, _)| key == name)?;
        Some(self.attributes.remove(index).1)
    }

    pub(crate) fn with(mut self, name: &str, value: impl Into<String>) -> Self {
        self.set(name, value);
        self
    }

    pub(crate) fn attributes(&self) -> impl Iterator<Item = (&str, &str)> {
        self.attributes.iter().map(|(key, value)| (key.as_str(), value.as_str()))
    }

    pub(crate) fn name(&self) -> Option<&str> {
        self.get("name")
    }

    pub(crate) fn child(&self, tag: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.tag == tag)
    }

    /// Returns the first direct child with this tag, creating one if there is none.
    pub(crate) fn child_mut(&mut self, tag: &str) -> &mut Self {
        let index = match self.children.iter().position(|child| child.tag == tag) {
            Some(index) => index,
            None => {
                self.children.push(Self::new(tag));
                self.children.len() - 1
            }
        };
        &mut self.children[index]
    }

    /// Finds this element or a descendant by tag and name, in document order.
    pub(crate) fn find(&self, tag: &str, name: &str) -> Option<&Self> {
        self.descendants().into_iter().find(|e| e.tag == tag && e.name() == Some(name))
    }

    pub(crate) fn find_mut(&mut self, tag: &str, name: &str) -> Option<&mut Self> {
        if self.tag == tag && self.name() == Some(name) {
            return Some(self);
        }
        self.children.iter_mut().find_map(|child| child.find_mut(tag, name))
    }

    /// Returns this element and all its descendants, in document order.
    pub(crate) fn descendants(&self) -> Vec<&Self> {
        let mut all = vec![self];
        for child in &self.children {
            all.extend(child.descendants());
        }
        all
    }

    pub(crate) fn for_each_mut(&mut self, change: &mut impl FnMut(&mut Self)) {
        change(self);
        for child in &mut self.children {
            child.for_each_mut(change);
        }
    }

    pub(crate) fn write(&self) -> String {
        let mut text = String::new();
        self.write_to(&mut text, 0);
        text
    }

    fn write_to(&self, text: &mut String, depth: usize) {
        let _ = write!(text, "{:indent$}<{}", "", self.tag, indent = depth * 2);
        for (name, value) in &self.attributes {
            let _ = write!(text, " {name}=\"{}\"", escape(value));
        }
        if self.children.is_empty() {
            text.push_str("/>\n");
            return;
        }
        text.push_str(">\n");
        for child in &self.children {
            child.write_to(text, depth + 1);
        }
        let _ = writeln!(text, "{:indent$}</{}>", "", self.tag, indent = depth * 2);
    }
}

fn escape(value: &str) -> String {
    value
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
        // An XML parser normalises literal white space in attributes to spaces.
        .replace('\t', "&#9;")
        .replace('\n', "&#10;")
        .replace('\r', "&#13;")
}

/// Formats numbers for MJCF, each in the shortest form that parses to the same double.
pub(crate) fn numbers(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(f64::to_string).collect();
    words.join(" ")
}

pub(crate) fn parse_numbers(text: &str) -> Option<Vec<f64>> {
    text.split_whitespace().map(|word| word.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_in_namespaces_are_refused() {
        let problem = Element::parse(r#"<a xmlns:b="c" name="x" b:name="y"/>"#).unwrap_err();
        assert_eq!(problem, "attribute `name` is in a namespace");
    }

    #[test]
    fn writing_and_reading_again_gives_the_same_tree() {
        let element = Element::new("a")
            .with("name", "x \"<&>\" \t\r\n y")
            .with("pos", numbers(&[0.1, -0.0, 1e-300, 5.0]));
        let mut outer = Element::new("b");
        outer.children.push(element);
        assert_eq!(Element::parse(&outer.write()).unwrap(), outer);
        assert_eq!(parse_numbers("1 -2.5e-3"), Some(vec![1.0, -0.0025]));
    }
}
