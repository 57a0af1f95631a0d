//! BDDL problem files: objects, initial state and goal of a task. LIBERO's dialect:
//! case-insensitive s-expressions, `;` comments.

use std::fmt;

use benchmark::Predicate;

use crate::expression::{Expression, Kind, read_expression};

pub use crate::expression::BddlError;

#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// Problem class, lower case: `libero_tabletop_manipulation`.
    pub name: String,
    /// Instruction as in the file, lower case; empty if there is none.
    pub language: String,
    pub fixtures: Vec<Declaration>,
    pub objects: Vec<Declaration>,
    pub regions: Vec<Region>,
    pub objects_of_interest: Vec<String>,
    pub init: Vec<Predicate>,
    pub goal: Vec<Predicate>,
}

/// An instance and its category: `akita_black_bowl_1 - akita_black_bowl`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Declaration {
    pub name: String,
    pub category: String,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Full name: target, `_`, region.
    pub name: String,
    /// The workspace, object or fixture that the region belongs to.
    pub target: String,
    /// Rectangles in the workspace's plane, m.
    pub ranges: Vec<Rectangle>,
    /// Bounds of the yaw that is drawn for a fixture in the region, rad, in the file's order.
    pub yaw: [f64; 2],
    /// Colour of the region's site: red, green, blue, opacity.
    pub rgba: [f64; 4],
}

/// A rectangle, m: two corners as the file writes them (x, y, x, y).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    pub x: [f64; 2],
    pub y: [f64; 2],
}

impl Problem {
    pub fn parse(text: &str) -> Result<Self, BddlError> {
        let root = read_expression(text)?;
        let items = root.list("the file")?;
        match items.first().map(|item| item.word("`define`")).transpose()? {
            Some("define") => {}
            _ => return Err(root.error("expected `(define (problem …) …)`")),
        }
        let mut problem = Problem {
            name: String::new(),
            language: String::new(),
            fixtures: Vec::new(),
            objects: Vec::new(),
            regions: Vec::new(),
            objects_of_interest: Vec::new(),
            init: Vec::new(),
            goal: Vec::new(),
        };
        for section in &items[1..] {
            problem.read_section(section)?;
        }
        if problem.name.is_empty() {
            return Err(root.error("no `(problem NAME)`"));
        }
        if problem.goal.is_empty() {
            return Err(root.error("no `(:goal …)`"));
        }
        Ok(problem)
    }

    pub fn region(&self, name: &str) -> Option<&Region> {
        // The last of equal names wins, as in hf-libero's dictionary of regions.
        self.regions.iter().rev().find(|region| region.name == name)
    }

    fn read_section(&mut self, section: &Expression) -> Result<(), BddlError> {
        let items = section.list("a section")?;
        let Some((head, rest)) = items.split_first() else {
            return Err(section.error("empty section"));
        };
        match head.word("a section's name")? {
            "problem" => {
                self.name = section.last_word(rest, "the problem's name")?.to_owned();
            }
            ":domain" => {
                let domain = section.last_word(rest, "the domain's name")?;
                if domain != "robosuite" {
                    return Err(section.error(format!("domain `{domain}` is not `robosuite`")));
                }
            }
            ":fixtures" => self.fixtures = read_declarations(rest)?,
            ":objects" => self.objects = read_declarations(rest)?,
            ":obj_of_interest" => self.objects_of_interest = read_words(rest)?,
            ":regions" => {
                self.regions = rest.iter().map(read_region).collect::<Result<_, _>>()?;
            }
            ":init" => self.init = rest.iter().map(read_predicate).collect::<Result<_, _>>()?,
            ":goal" => self.goal = read_goal(section, rest)?,
            ":language" => {
                let word = |item: &'_ Expression| {
                    let what = "a word of the instruction, which has no parentheses";
                    item.word(what).map(str::to_owned)
                };
                let words: Result<Vec<String>, _> = rest.iter().map(word).collect();
                self.language = words?.join(" ");
            }
            ":requirements" | ":scene_properties" => {}
            other => return Err(section.error(format!("unknown section `{other}`"))),
        }
        Ok(())
    }
}

/// Writes the problem as a BDDL file that parses to the same problem.
impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let declare = |f: &mut fmt::Formatter<'_>, section: &str, all: &[Declaration]| {
            writeln!(f, "  ({section}")?;
            for declaration in all {
                writeln!(f, "    {} - {}", declaration.name, declaration.category)?;
            }
            writeln!(f, "  )")
        };
        writeln!(
            f,
            "(define (problem {})\n  (:domain robosuite)\n  (:language {})\n  (:regions",
            self.name, self.language
        )?;
        for region in &self.regions {
            writeln!(f, "    {region}")?;
        }
        writeln!(f, "  )")?;
        declare(f, ":fixtures", &self.fixtures)?;
        declare(f, ":objects", &self.objects)?;
        writeln!(f, "  (:obj_of_interest {})", self.objects_of_interest.join(" "))?;
        writeln!(f, "  (:init")?;
        for predicate in &self.init {
            writeln!(f, "    {predicate}")?;
        }
        writeln!(f, "  )\n  (:goal (and")?;
        for predicate in &self.goal {
            writeln!(f, "    {predicate}")?;
        }
        writeln!(f, "  ))\n)")
    }
}

impl fmt::Display for Region {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name.strip_prefix(&format!("{}_", self.target)).unwrap_or(&self.name);
        write!(f, "({name} (:target {})", self.target)?;
        if !self.ranges.is_empty() {
            write!(f, " (:ranges (")?;
            for Rectangle { x, y } in &self.ranges {
                write!(f, "({} {} {} {})", x[0], y[0], x[1], y[1])?;
            }
            write!(f, "))")?;
        }
        let [low, high] = self.yaw;
        let [red, green, blue, opacity] = self.rgba;
        write!(f, " (:yaw_rotation (({low} {high}))) (:rgba ({red} {green} {blue} {opacity})))")
    }
}

fn read_words(items: &[Expression]) -> Result<Vec<String>, BddlError> {
    items.iter().map(|item| item.word("a name").map(str::to_owned)).collect()
}

fn read_declarations(items: &[Expression]) -> Result<Vec<Declaration>, BddlError> {
    let mut declarations = Vec::new();
    let mut pending: Vec<&Expression> = Vec::new();
    let mut items = items.iter();
    while let Some(item) = items.next() {
        let word = item.word("a name or `-`")?;
        if word != "-" {
            pending.push(item);
            continue;
        }
        let category = items
            .next()
            .ok_or_else(|| item.error("a category must follow `-`"))?
            .word("a category")?;
        for name in pending.drain(..) {
            let name = name.word("a name")?.to_owned();
            declarations.push(Declaration { name, category: category.to_owned() });
        }
    }
    match pending.last() {
        None => Ok(declarations),
        Some(item) => Err(item.error(format!("`{}` has no category", item.word("a name")?))),
    }
}

fn read_region(item: &Expression) -> Result<Region, BddlError> {
    let parts = item.list("a region")?;
    let Some((name, attributes)) = parts.split_first() else {
        return Err(item.error("a region without a name"));
    };
    let name = name.word("a region's name")?;
    let mut region = Region {
        name: String::new(),
        target: String::new(),
        ranges: Vec::new(),
        yaw: [0.0, 0.0],
        rgba: [0.0, 0.0, 1.0, 0.0],
    };
    for attribute in attributes {
        let parts = attribute.list("a region's attribute")?;
        let [key, value] = parts else {
            return Err(attribute.error("expected one key and one value"));
        };
        match key.word("a region's attribute")? {
            ":target" => region.target = value.word("a target")?.to_owned(),
            ":ranges" => {
                for rectangle in value.list("rectangles")? {
                    let [x0, y0, x1, y1] = rectangle.numbers("a rectangle")?;
                    region.ranges.push(Rectangle { x: [x0, x1], y: [y0, y1] });
                }
            }
            ":yaw_rotation" => {
                for bounds in value.list("yaw bounds")? {
                    region.yaw = bounds.numbers("yaw bounds")?;
                }
            }
            ":rgba" => region.rgba = value.numbers("a colour")?,
            other => return Err(attribute.error(format!("unknown attribute `{other}`"))),
        }
    }
    if region.target.is_empty() {
        return Err(item.error(format!("region `{name}` has no `(:target …)`")));
    }
    region.name = format!("{}_{name}", region.target);
    Ok(region)
}

fn read_predicate(item: &Expression) -> Result<Predicate, BddlError> {
    let words = read_words(item.list("a predicate")?)?;
    match words.split_first() {
        Some((name, arguments)) if !arguments.is_empty() => {
            Ok(Predicate { name: name.clone(), arguments: arguments.to_vec() })
        }
        _ => Err(item.error("a predicate needs a name and at least one argument")),
    }
}

fn read_goal(section: &Expression, rest: &[Expression]) -> Result<Vec<Predicate>, BddlError> {
    let [goal] = rest else {
        return Err(section.error("expected one expression in `:goal`"));
    };
    let read = |item: &Expression| {
        // `Or`, `Not` and a second `And` would otherwise be read as predicates of lists.
        let nested = item.list("a predicate")?.iter().any(|part| part.word("").is_err());
        match nested {
            true => Err(item.error("the goal is one predicate, or predicates under one `And`")),
            false => read_predicate(item),
        }
    };
    let items = goal.list("a goal")?;
    match items.first() {
        Some(Expression { kind: Kind::Word(word), .. }) if word == "and" => {
            items[1..].iter().map(read).collect()
        }
        _ => Ok(vec![read(goal)?]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instruction_with_parentheses_and_a_nested_goal_are_refused_in_words() {
        let message = |from: &str, to: &str| {
            let text = SMALL.replace(from, to);
            assert_ne!(text, SMALL);
            Problem::parse(&text).expect_err("refused").to_string()
        };
        let listed = message("Put it there", "Put it (the red one) there");
        assert!(listed.contains("instruction, which has no parentheses"), "{listed}");
        let nested = message("(:goal (And", "(:goal (And (Not (Open a))");
        assert!(nested.contains("predicates under one `And`"), "{nested}");
    }

    const SMALL: &str = "(define (problem LIBERO_Floor_Manipulation) ; a comment
      (:domain robosuite)
      (:language Put it there)
      (:regions (bin_region (:target floor) (:ranges ((-0.01 0.25 0.01 0.27))))
                (contain_region (:target basket_1)))
      (:fixtures floor - floor)
      (:objects milk_1 milk_2 - milk basket_1 - basket)
      (:obj_of_interest milk_1 basket_1)
      (:init (On basket_1 floor_bin_region))
      (:goal (And (In milk_1 basket_1_contain_region))))";

    #[test]
    fn a_small_problem_is_parsed_and_written() {
        let problem = Problem::parse(SMALL).unwrap();
        assert_eq!(problem.name, "libero_floor_manipulation");
        assert_eq!(problem.objects.len(), 3);
        assert_eq!(problem.objects[1].category, "milk");
        assert_eq!(Problem::parse(&problem.to_string()).unwrap(), problem);
        let region = problem.region("floor_bin_region").unwrap();
        assert_eq!(region.ranges, [Rectangle { x: [-0.01, 0.01], y: [0.25, 0.27] }]);
        assert_eq!(problem.goal[0].to_string(), "(in milk_1 basket_1_contain_region)");
    }

    #[test]
    fn errors_name_the_line() {
        let check = |text: &str, expected: &str| {
            assert_eq!(Problem::parse(text).unwrap_err().to_string(), expected);
        };
        check("", "line 1: the file is empty");
        check("(define\n(problem x", "line 2: `(` is never closed");
        check("(define (problem x)\n (:goal (on a b)))\n)", "line 3: `)` without `(`");
        check(&SMALL.replace("-0.01 0.25", "-0.01 east"), "line 4: `east` is not a number");
        check(&SMALL.replace("(:init", "(:initially"), "line 9: unknown section `:initially`");
        check(
            &SMALL.replace("basket_1 - basket)", "basket_1)"),
            "line 7: `basket_1` has no category",
        );
    }
}
