//! Parser of s-expressions: records line numbers, converts to lower case, drops `;` comments. The
//! module `bddl` interprets them.

#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("line {line}: {problem}")]
pub struct BddlError {
    /// Line, counted from 1.
    pub line: usize,
    pub problem: String,
}

#[derive(Debug)]
pub(crate) struct Expression {
    line: usize,
    pub(crate) kind: Kind,
}

#[derive(Debug)]
pub(crate) enum Kind {
    Word(String),
    List(Vec<Expression>),
}

/// Limit of nesting, beyond any real problem file; bounds the stack.
const MAX_DEPTH: usize = 64;

impl Expression {
    pub(crate) fn error(&self, problem: impl Into<String>) -> BddlError {
        BddlError { line: self.line, problem: problem.into() }
    }

    pub(crate) fn word(&self, what: &str) -> Result<&str, BddlError> {
        match &self.kind {
            Kind::Word(word) => Ok(word),
            Kind::List(_) => Err(self.error(format!("expected {what}, found a list"))),
        }
    }

    pub(crate) fn list(&self, what: &str) -> Result<&[Expression], BddlError> {
        match &self.kind {
            Kind::List(items) => Ok(items),
            Kind::Word(word) => Err(self.error(format!("expected {what}, found `{word}`"))),
        }
    }

    pub(crate) fn last_word<'a>(
        &self,
        rest: &'a [Expression],
        what: &str,
    ) -> Result<&'a str, BddlError> {
        rest.last().ok_or_else(|| self.error(format!("expected {what}")))?.word(what)
    }

    pub(crate) fn numbers<const N: usize>(&self, what: &str) -> Result<[f64; N], BddlError> {
        let items = self.list(what)?;
        let numbers: Vec<f64> = items
            .iter()
            .map(|item| {
                let word = item.word("a number")?;
                match word.parse::<f64>() {
                    Ok(number) if number.is_finite() => Ok(number),
                    _ => Err(item.error(format!("`{word}` is not a number"))),
                }
            })
            .collect::<Result<_, _>>()?;
        numbers.try_into().map_err(|found: Vec<f64>| {
            self.error(format!("{what}: expected {N} numbers, found {}", found.len()))
        })
    }
}

pub(crate) fn read_expression(text: &str) -> Result<Expression, BddlError> {
    let mut open: Vec<Expression> = Vec::new();
    let mut root = None;
    for (index, line) in text.lines().enumerate() {
        let number = index + 1;
        let code = line.split(';').next().unwrap_or_default().to_lowercase();
        for token in tokens(&code) {
            let error = |problem: &str| BddlError { line: number, problem: problem.to_owned() };
            let finished = match token {
                "(" if open.len() == MAX_DEPTH => return Err(error("nested too deeply")),
                "(" => {
                    open.push(Expression { line: number, kind: Kind::List(Vec::new()) });
                    continue;
                }
                ")" => open.pop().ok_or_else(|| error("`)` without `(`"))?,
                word => Expression { line: number, kind: Kind::Word(word.to_owned()) },
            };
            match open.last_mut() {
                Some(Expression { kind: Kind::List(items), .. }) => items.push(finished),
                _ if root.is_none() => root = Some(finished),
                _ => return Err(error("more than one expression in the file")),
            }
        }
    }
    match (open.last(), root) {
        (Some(list), _) => Err(list.error("`(` is never closed")),
        (None, Some(root)) => Ok(root),
        (None, None) => Err(BddlError { line: 1, problem: "the file is empty".to_owned() }),
    }
}

fn tokens(code: &str) -> impl Iterator<Item = &str> {
    let is_paren = |c: char| c == '(' || c == ')';
    code.split_whitespace().flat_map(move |chunk| {
        chunk.split_inclusive(is_paren).flat_map(move |piece| {
            // A piece is a word, a parenthesis, or a word that ends with a parenthesis.
            let split = if piece.ends_with(is_paren) { piece.len() - 1 } else { piece.len() };
            let (word, paren) = piece.split_at(split);
            [word, paren].into_iter().filter(|token| !token.is_empty())
        })
    })
}
