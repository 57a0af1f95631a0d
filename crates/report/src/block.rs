//! The parts of a report, each rendered as text for a terminal of 80 columns and as HTML. A column
//! of a table has its own note, from which the page's notes and the legend of the text are made.

mod latex;

use std::fmt::{Display, Write};

use maud::{Markup, html};

pub(crate) use self::latex::latex;
use crate::words::minus_signs;

/// Columns of a terminal.
pub(crate) const WIDTH: usize = 80;
/// Hexadecimal digits of a digest.
const SHA256: usize = 64;

/// Appends a paragraph whose first line follows `prefix`, and whose further lines align with it.
pub(crate) fn push_wrapped(text: &mut String, prefix: &str, words: &str) {
    text.push_str(&terminal::wrapped(prefix, prefix.chars().count(), words));
    text.push('\n');
}

/// A section of a report; without blocks, it is not rendered.
pub(crate) struct Section<'a> {
    /// Title on the page.
    pub(crate) title: String,
    pub(crate) blocks: Vec<Block<'a>>,
}

pub(crate) enum Block<'a> {
    /// Title of the following blocks.
    Heading(String),
    Paragraph(String),
    Table(Table),
    /// A table that the page folds.
    Folded(Table),
    /// Names, each with its words.
    Terms(Vec<(String, String)>),
    /// A part of the page alone, such as a figure.
    Html(Box<dyn Fn() -> Markup + 'a>),
}

impl Block<'_> {
    fn is_some(&self) -> bool {
        match self {
            Self::Table(table) | Self::Folded(table) => !table.rows.is_empty(),
            Self::Html(part) => !part().0.is_empty(),
            Self::Heading(_) | Self::Paragraph(_) | Self::Terms(_) => true,
        }
    }
}

/// A table: its rows are records, and each has a cell in every column.
#[derive(Debug, Default)]
pub(crate) struct Table {
    pub(crate) name: String,
    columns: Vec<Column>,
    rows: Vec<Vec<Cell>>,
    /// Symbols in cells, and their meanings.
    notes: Vec<(String, String)>,
}

#[derive(Debug)]
struct Column {
    name: String,
    unit: &'static str,
    /// Meaning of the name; empty if it needs none.
    note: String,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Part of the record's name.
    Key,
    Words,
    Number,
}

/// A value, and lines of smaller type below it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cell {
    text: String,
    below: Vec<String>,
    /// URL of the value on the page.
    link: Option<String>,
}

pub(crate) fn cell(text: impl Display) -> Cell {
    Cell { text: text.to_string(), ..Cell::default() }
}

/// Returns a cell with the value, or a dash for `None`.
pub(crate) fn or_dash(value: Option<impl Display>) -> Cell {
    value.map_or_else(|| cell("–"), cell)
}

impl Cell {
    /// Adds a line, unless it is empty.
    pub(crate) fn below(mut self, line: impl Into<String>) -> Self {
        let line = line.into();
        self.below.extend((!line.is_empty()).then_some(line));
        self
    }

    /// Links the value on the page.
    pub(crate) fn link(self, link: Option<String>) -> Self {
        Self { link, ..self }
    }

    /// Marks the value.
    pub(crate) fn star(&mut self) {
        self.text.push('*');
    }

    /// Returns the lines for a terminal, with hyphens for dashes.
    fn lines(&self) -> Vec<String> {
        let lines = [&self.text].into_iter().chain(&self.below);
        lines.map(|line| line.replace('–', "-")).collect()
    }

    fn html(&self) -> Markup {
        html! {
            @match &self.link {
                Some(link) => a href=(link) { code { (self.text) } },
                None => (self.text),
            }
            @for line in &self.below { small { (line) } }
        }
    }
}

/// A table under construction, with the records of its rows.
pub(crate) struct Rows<R> {
    records: Vec<R>,
    table: Table,
}

impl<R> Rows<R> {
    pub(crate) fn new(name: impl Into<String>, records: impl IntoIterator<Item = R>) -> Self {
        let records: Vec<R> = records.into_iter().collect();
        let rows = records.iter().map(|_| Vec::new()).collect();
        Self { records, table: Table { name: name.into(), rows, ..Table::default() } }
    }

    fn add(mut self, column: Column, value: impl Fn(&R) -> Cell) -> Self {
        self.table.columns.push(column);
        for (record, row) in self.records.iter().zip(&mut self.table.rows) {
            row.push(value(record));
        }
        self
    }

    /// Adds a column with a part of the records' names.
    pub(crate) fn key(self, name: &str, value: impl Fn(&R) -> Cell) -> Self {
        let note = String::new();
        self.add(Column { name: name.to_owned(), unit: "", note, kind: Kind::Key }, value)
    }

    /// Adds a column of words.
    pub(crate) fn words(self, name: &str, value: impl Fn(&R) -> Cell) -> Self {
        let note = String::new();
        self.add(Column { name: name.to_owned(), unit: "", note, kind: Kind::Words }, value)
    }

    /// Adds a column of numbers.
    pub(crate) fn column(
        self,
        name: impl Into<String>,
        unit: &'static str,
        note: impl Into<String>,
        value: impl Fn(&R) -> Cell,
    ) -> Self {
        let (name, note) = (name.into(), note.into());
        self.add(Column { name, unit, note, kind: Kind::Number }, value)
    }

    /// Changes the table if a condition holds.
    pub(crate) fn when(self, holds: bool, change: impl FnOnce(Self) -> Self) -> Self {
        if holds { change(self) } else { self }
    }

    /// Adds the meaning of a symbol in cells.
    pub(crate) fn note(mut self, symbol: impl Into<String>, meaning: impl Into<String>) -> Self {
        self.table.notes.push((symbol.into(), meaning.into()));
        self
    }

    pub(crate) fn table(self) -> Table {
        self.table
    }
}

impl Table {
    /// Returns the meanings of the columns' names and of the symbols in cells.
    fn meanings(&self) -> impl Iterator<Item = (&str, &str)> {
        let columns = self.columns.iter().filter(|column| !column.note.is_empty());
        let columns = columns.map(|column| (column.name.as_str(), column.note.as_str()));
        columns.chain(self.notes.iter().map(|(symbol, note)| (symbol.as_str(), note.as_str())))
    }

    pub(crate) fn html(&self) -> Markup {
        html! {
            @if !self.rows.is_empty() { h4 { (self.name) } }
            (self.box_html())
            @if !self.rows.is_empty() && self.meanings().next().is_some() {
                p.muted {
                    @for (symbol, meaning) in self.meanings() { (symbol) ": " (meaning) ". " }
                }
            }
        }
    }

    /// Renders the table in a box that scrolls if it is wider than the page, and that the keyboard
    /// reaches.
    fn box_html(&self) -> Markup {
        let class = |column: &Column| match column.kind {
            Kind::Key => Some("key"),
            Kind::Words => Some("words"),
            Kind::Number => None,
        };
        html! {
            @if !self.rows.is_empty() {
                div.scroll tabindex="0" role="region" aria-label=(self.name) {
                    table {
                        thead {
                            tr {
                                @for column in &self.columns {
                                    th scope="col" class=[class(column)] { (column.head()) }
                                }
                            }
                        }
                        tbody {
                            @for row in &self.rows {
                                tr {
                                    th scope="row" { div { (row[0].html()) } }
                                    @for (value, column) in row.iter().zip(&self.columns).skip(1) {
                                        td class=[class(column)] { (value.html()) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    /// Renders the table folded.
    pub(crate) fn folded(&self) -> Markup {
        html! {
            @if !self.rows.is_empty() { details { summary { (self.name) } (self.box_html()) } }
        }
    }

    /// Writes the table for a terminal: a line per record, below headings if the lines are too
    /// wide otherwise, or else a column per record, or a paragraph per cell.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        if self.rows.is_empty() {
            return text;
        }
        push_wrapped(&mut text, "", &self.name);
        let records: Vec<Vec<Vec<String>>> =
            self.rows.iter().map(|row| row.iter().map(Cell::lines).collect()).collect();
        let head = |(index, column): (usize, &Column)| {
            let cells = records.iter().flat_map(|record| &record[index]);
            let width = cells.map(|line| line.chars().count()).max().unwrap_or_default();
            in_lines(&column.head(), width)
        };
        let heads: Vec<Vec<String>> = self.columns.iter().enumerate().map(head).collect();
        let flat: Vec<_> = [bottom_aligned(heads)].into_iter().chain(records.clone()).collect();
        let is_left = self.columns.iter().enumerate();
        let is_left: Vec<bool> =
            is_left.map(|(index, column)| index == 0 || column.kind != Kind::Number).collect();
        if total_width(&flat) <= WIDTH {
            push_grid(&mut text, &is_left, &flat, &widths(&flat));
            return text;
        }
        // Without its first column, whose cells become headings of the rows below them.
        let grouped: Vec<_> = flat.iter().map(|row| row[1..].to_vec()).collect();
        if self.columns.len() > 2 && total_width(&grouped) <= WIDTH {
            let widths = widths(&grouped);
            push_grid(&mut text, &is_left[1..], &grouped[..1], &widths);
            let mut heading = None;
            for (row, record) in grouped[1..].iter().zip(&records) {
                if heading.replace(&record[0]) != Some(&record[0]) {
                    push_wrapped(&mut text, "", &record[0].join(" "));
                }
                push_grid(&mut text, &is_left[1..], std::slice::from_ref(row), &widths);
            }
            return text;
        }
        let mut rest = records.as_slice();
        while !rest.is_empty() {
            let fits = |count: &usize| total_width(&self.transposed(&rest[..*count])) <= WIDTH;
            let Some(count) = (1..=rest.len()).rev().find(fits) else {
                self.push_listed(&mut text, &rest[0]);
                rest = &rest[1..];
                continue;
            };
            let transposed = self.transposed(&rest[..count]);
            let is_left: Vec<bool> = (0..=count).map(|index| index == 0).collect();
            push_grid(&mut text, &is_left, &transposed, &widths(&transposed));
            rest = &rest[count..];
            if !rest.is_empty() {
                text.push('\n');
            }
        }
        text
    }

    /// Appends a record with a paragraph per column.
    fn push_listed(&self, text: &mut String, record: &[Vec<String>]) {
        let cells = || self.columns.iter().zip(record);
        let keys = cells().filter(|(column, _)| column.kind == Kind::Key);
        let keys: Vec<String> = keys.map(|(_, lines)| lines.join(" ")).collect();
        push_wrapped(text, "", &keys.join(" "));
        for (column, lines) in cells().filter(|(column, _)| column.kind != Kind::Key) {
            let words = lines.join(" ");
            if !words.is_empty() {
                push_wrapped(text, &format!("  {}: ", column.head()), &words);
            }
        }
    }

    /// Returns the rows of a table with a column per record.
    fn transposed(&self, records: &[Vec<Vec<String>>]) -> Vec<Vec<Vec<String>>> {
        let columns = self.columns.iter().enumerate();
        let row = |(index, column): (usize, &Column)| {
            let label = match column.kind {
                Kind::Key => String::new(),
                Kind::Words | Kind::Number => column.head(),
            };
            let cells = records.iter().map(|record| record[index].clone());
            [vec![label]].into_iter().chain(cells).collect()
        };
        columns.map(row).collect()
    }
}

impl Column {
    fn head(&self) -> String {
        format!("{} {}", self.name, self.unit).trim_end().to_owned()
    }
}

/// Breaks words into lines of at most `width` characters, if no word is longer.
pub(crate) fn in_lines(words: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split(' ').filter(|word| !word.is_empty()) {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn bottom_aligned(mut cells: Vec<Vec<String>>) -> Vec<Vec<String>> {
    let height = cells.iter().map(Vec::len).max().unwrap_or_default();
    for lines in &mut cells {
        let missing = height - lines.len();
        lines.splice(0..0, vec![String::new(); missing]);
    }
    cells
}

fn widths(rows: &[Vec<Vec<String>>]) -> Vec<usize> {
    let columns = rows.first().map_or(0, Vec::len);
    let width = |column: usize| {
        let lines = rows.iter().flat_map(|row| &row[column]);
        lines.map(|line| line.chars().count()).max().unwrap_or_default()
    };
    (0..columns).map(width).collect()
}

fn total_width(rows: &[Vec<Vec<String>>]) -> usize {
    let widths = widths(rows);
    widths.iter().sum::<usize>() + widths.len().saturating_sub(1)
}

/// Appends rows of cells of several lines.
fn push_grid(text: &mut String, is_left: &[bool], rows: &[Vec<Vec<String>>], widths: &[usize]) {
    // A wider gap is easier to read.
    let is_wide = widths.iter().sum::<usize>() + 2 * (widths.len() - 1) <= WIDTH;
    let gap = if is_wide { "  " } else { " " };
    for row in rows {
        for index in 0..row.iter().map(Vec::len).max().unwrap_or_default() {
            let mut line = String::new();
            for ((cell, &width), is_left) in row.iter().zip(widths).zip(is_left) {
                let value = cell.get(index).map_or("", String::as_str);
                let _ = match is_left {
                    true => write!(line, "{value:<width$}{gap}"),
                    false => write!(line, "{value:>width$}{gap}"),
                };
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
    }
}

/// Writes blocks for a terminal, with the legend of their tables below them.
pub(crate) fn text<'a, 'b: 'a>(blocks: impl IntoIterator<Item = &'a Block<'b>>) -> String {
    let mut text = String::new();
    let blocks: Vec<&Block<'_>> = blocks.into_iter().collect();
    let mut follows_prose = false;
    for block in &blocks {
        let part = match block {
            Block::Heading(words) | Block::Paragraph(words) => {
                let mut part = String::new();
                push_wrapped(&mut part, "", words);
                part
            }
            Block::Table(table) | Block::Folded(table) => table.text(),
            Block::Terms(terms) => {
                let terms = terms.iter().map(|(name, words)| (name.as_str(), words.as_str()));
                terms_text(&terms.collect::<Vec<_>>(), WIDTH - SHA256 - 2)
            }
            Block::Html(_) => continue,
        };
        let is_prose = matches!(block, Block::Paragraph(_));
        if !(text.is_empty() || part.is_empty() || is_prose && follows_prose) {
            text.push('\n');
        }
        follows_prose = is_prose;
        text.push_str(&part);
    }
    let legend = terms_text(&legend(blocks), WIDTH);
    if !legend.is_empty() {
        text.push('\n');
        text.push_str(&legend);
    }
    text.replace('−', "-")
}

/// Appends blocks, below an empty line unless the text is empty.
pub(crate) fn push_text<'a, 'b: 'a>(
    text: &mut String,
    blocks: impl IntoIterator<Item = &'a Block<'b>>,
) {
    if !text.is_empty() && !text.ends_with("\n\n") {
        text.push('\n');
    }
    text.push_str(&self::text(blocks));
}

/// Writes names, each with its words beside it, in a column that begins after `most` letters or before.
fn terms_text(terms: &[(&str, &str)], most: usize) -> String {
    let width = terms.iter().map(|(name, _)| name.chars().count()).max();
    let width = width.unwrap_or_default().min(most);
    let lines = terms.iter().map(|(name, words)| {
        terminal::wrapped(&format!("{name:<width$}  "), width + 2, words) + "\n"
    });
    lines.collect()
}

/// Returns the meanings in all tables, each once.
pub(crate) fn legend<'a, 'b: 'a>(
    blocks: impl IntoIterator<Item = &'a Block<'b>>,
) -> Vec<(&'a str, &'a str)> {
    let mut legend = Vec::new();
    for block in blocks {
        if let Block::Table(table) | Block::Folded(table) = block
            && !table.rows.is_empty()
        {
            for meaning in table.meanings() {
                if !legend.contains(&meaning) {
                    legend.push(meaning);
                }
            }
        }
    }
    legend
}

/// Renders sections for the page: a table of contents, the open sections, and the folded ones.
pub(crate) fn html(open: &[Section<'_>], folded: &[Section<'_>]) -> Markup {
    let is_some = |section: &&Section<'_>| section.blocks.iter().any(Block::is_some);
    let id = |section: &Section<'_>| section.title.to_lowercase().replace(' ', "-");
    let folded: Vec<&Section<'_>> = folded.iter().filter(is_some).collect();
    html! {
        @if folded.len() > 1 {
            nav.contents aria-label="Contents" {
                @for section in &folded { a href={ "#" (id(section)) } { (section.title) } }
            }
        }
        @for section in open.iter().filter(is_some) {
            section { h2 { (section.title) } (blocks_html(&section.blocks)) }
        }
        @for section in &folded {
            details.section {
                summary { h2 { (section.title) } }
                // Browsers unfold the section that holds the target of a link.
                div id=(id(section)) { (blocks_html(&section.blocks)) }
            }
        }
    }
}

pub(crate) fn blocks_html(blocks: &[Block<'_>]) -> Markup {
    html! {
        @for block in blocks {
            @match block {
                Block::Heading(words) => h3 { (words) },
                Block::Paragraph(words) => p { (in_code(&minus_signs(words))) },
                Block::Table(table) => (table.html()),
                Block::Folded(table) => (table.folded()),
                Block::Terms(terms) => {
                    dl.methods { @for (name, words) in terms { dt { (name) } dd { (in_code(words)) } } }
                },
                Block::Html(part) => (part()),
            }
        }
    }
}

/// Renders words, with names between backticks as code.
pub(crate) fn in_code(words: &str) -> Markup {
    html! {
        @for (index, part) in words.split('`').enumerate() {
            @if index % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}
