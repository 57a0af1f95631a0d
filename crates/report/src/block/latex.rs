//! Blocks as LaTeX: tables with the rules of the package `booktabs`.

use super::{Block, Cell, Kind, Table};

/// Most columns of a table that is neither transposed nor sideways.
const MOST_COLUMNS: usize = 13;
/// Shrinks a table that is wider than the text.
const FITTING: &str = "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}";

/// Writes paragraphs and tables; figures are files of their own.
pub(crate) fn latex<'a, 'b: 'a>(blocks: impl IntoIterator<Item = &'a Block<'b>>) -> String {
    let parts = blocks.into_iter().filter_map(|block| match block {
        Block::Heading(words) => Some(format!("\\paragraph{{{}}}\n", escaped(words))),
        Block::Paragraph(words) => Some(format!("{}\n", escaped(words))),
        Block::Table(table) | Block::Folded(table) if !table.rows.is_empty() => Some(table.latex()),
        Block::Table(_) | Block::Folded(_) | Block::Terms(_) | Block::Html(_) => None,
    });
    let parts: Vec<String> = parts.collect();
    format!("% Needs \\usepackage{{booktabs,graphicx,rotating}}.\n\n{}", parts.join("\n"))
}

impl Table {
    /// Writes the table. One of many columns is transposed, with a column per record, if it has fewer
    /// records than columns; otherwise it is printed sideways.
    fn latex(&self) -> String {
        let records: Vec<Vec<Vec<String>>> =
            self.rows.iter().map(|row| row.iter().map(Cell::lines).collect()).collect();
        let is_transposed =
            self.columns.len() > MOST_COLUMNS && self.rows.len() < self.columns.len();
        let lines = match is_transposed {
            true => self.transposed(&records),
            false => {
                let heads = self.columns.iter().map(|column| vec![column.head()]).collect();
                [heads].into_iter().chain(records).collect()
            }
        };
        let heading_rows = if is_transposed { self.keys() } else { 1 };
        let is_sideways = self.columns.len() > MOST_COLUMNS && !is_transposed;
        let float = if is_sideways { "sidewaystable" } else { "table" };
        let columns: String = match is_transposed {
            true => format!("l{}", "r".repeat(self.rows.len())),
            false => {
                let columns = self.columns.iter();
                columns.map(|of| if of.kind == Kind::Number { 'r' } else { 'l' }).collect()
            }
        };
        let mut previous = "";
        let rows = lines.iter().enumerate().map(|(index, row)| {
            let name = row[0].first().map_or("", String::as_str);
            // Of consecutive rows with the same first key, only the first shows it.
            let repeats = self.keys() > 1 && !is_transposed && name == previous;
            previous = name;
            let cells = row.iter().skip(usize::from(repeats)).map(|lines| latex_cell(lines));
            let cells = repeats.then(String::new).into_iter().chain(cells);
            let rule = if index + 1 == heading_rows { "\\midrule\n" } else { "" };
            format!("{} \\\\\n{rule}", cells.collect::<Vec<_>>().join(" & "))
        });
        let rows: String = rows.collect();
        let notes = self.meanings().map(|(symbol, meaning)| format!(" {symbol}: {meaning}."));
        format!(
            "\\begin{{{float}}}\n\\centering\n\\caption{{{}.{}}}\n{FITTING}{{%\n\\begin{{tabular}}{{{columns}}}\n\
             \\toprule\n{rows}\\bottomrule\n\\end{{tabular}}}}\n\\end{{{float}}}\n",
            escaped(&self.name),
            escaped(&notes.collect::<String>()),
        )
    }

    fn keys(&self) -> usize {
        self.columns.iter().filter(|column| column.kind == Kind::Key).count()
    }
}

fn latex_cell(lines: &[String]) -> String {
    match lines {
        [] => String::new(),
        [only] => escaped(only),
        [first, below @ ..] => {
            let below = below.iter().map(|line| format!("\\\\\\scriptsize {}", escaped(line)));
            let below: String = below.collect();
            format!("\\begin{{tabular}}[t]{{@{{}}r@{{}}}}{}{below}\\end{{tabular}}", escaped(first))
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
            // LaTeX would read a `[` after `\\` as the beginning of an optional argument.
            '[' => text.push_str("{[}"),
            letter => text.push(letter),
        }
    }
    text
}
