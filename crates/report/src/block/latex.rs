//! Blocks as LaTeX: tables with the rules of the package `booktabs`.

use super::{Block, Cell, Kind, Table};

/// Shrinks a table that is wider than the text.
const FITTING: &str = "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}";

/// Writes paragraphs and tables; figures are files of their own.
pub(crate) fn latex<'a, 'b: 'a>(blocks: impl IntoIterator<Item = &'a Block<'b>>) -> String {
    let parts = blocks.into_iter().filter_map(|block| match block {
        Block::Heading(words) => Some(format!("\\paragraph{{{}}}\n", escaped(words))),
        Block::Paragraph(words) => Some(format!("{}\n", escaped(words))),
        Block::Table(table) | Block::Folded(table) if !table.rows.is_empty() => Some(table.latex()),
        Block::Table(_) | Block::Folded(_) | Block::Html(_) => None,
    });
    let parts: Vec<String> = parts.collect();
    format!("% Needs \\usepackage{{booktabs,graphicx}}.\n\n{}", parts.join("\n"))
}

impl Table {
    fn latex(&self) -> String {
        let columns: String =
            self.columns.iter().map(|of| if of.kind == Kind::Number { 'r' } else { 'l' }).collect();
        let heads: Vec<String> = self.columns.iter().map(|of| escaped(&of.head())).collect();
        let mut previous = "";
        let rows = self.rows.iter().map(|row| {
            let repeats = row.len() > 2 && row[0].text == previous;
            previous = &row[0].text;
            // A name stands in the first of its rows only.
            let cells = row.iter().enumerate().map(|(index, cell)| match repeats && index == 0 {
                true => String::new(),
                false => cell.latex(),
            });
            format!("{} \\\\\n", cells.collect::<Vec<_>>().join(" & "))
        });
        let rows: String = rows.collect();
        let notes = self.meanings().map(|(symbol, meaning)| format!(" {symbol}: {meaning}."));
        format!(
            "\\begin{{table}}\n\\centering\n\\caption{{{}.{}}}\n{FITTING}{{%\n\\begin{{tabular}}{{{columns}}}\n\
             \\toprule\n{} \\\\\n\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}}}\n\\end{{table}}\n",
            escaped(&self.name),
            escaped(&notes.collect::<String>()),
            heads.join(" & "),
        )
    }
}

impl Cell {
    fn latex(&self) -> String {
        let lines = self.below.iter().map(|line| format!("\\\\\\scriptsize {}", escaped(line)));
        match lines.collect::<String>() {
            below if below.is_empty() => escaped(&self.text),
            below => format!("\\shortstack[r]{{{}{below}}}", escaped(&self.text)),
        }
    }
}

fn escaped(words: &str) -> String {
    let mut text = String::new();
    for letter in words.chars() {
        match letter {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => text.extend(['\\', letter]),
            '\\' => text.push_str("\\textbackslash{}"),
            '~' => text.push_str("\\textasciitilde{}"),
            '^' => text.push_str("\\textasciicircum{}"),
            '<' | '>' | '|' => text.extend(['$', letter, '$']),
            '−' => text.push_str("$-$"),
            '±' => text.push_str("$\\pm$"),
            '·' => text.push_str("$\\cdot$"),
            '×' => text.push_str("$\\times$"),
            'Π' => text.push_str("$\\prod$"),
            'π' => text.push_str("$\\pi$"),
            'α' => text.push_str("$\\alpha$"),
            '–' => text.push_str("--"),
            // An interval after a line's end would be its optional argument.
            '[' => text.push_str("{[}"),
            letter => text.push(letter),
        }
    }
    text
}
