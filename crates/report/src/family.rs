//! Report of a campaign of LIBERO's family or of a suite file: successes by dimension, suite or
//! type and by difficulty, and the losses against the unperturbed rollouts of the same tasks and
//! initial states. Suite files have no unperturbed rollouts.

use std::collections::BTreeMap;

use benchmark::family::para::{Distances, Kind, Paraphrased};
use benchmark::family::plus::{Dimension, PUBLISHED, PUBLISHED_SOURCE};
use benchmark::family::pro::ProSuite;
use benchmark::family::protocol::Protocol;
use benchmark::family::{Case, SelectionError, Subject as CaseSubject};
use benchmark::{TaskRef, UnknownName};
use paired::{Bootstrap, Interval, NoInterval, Outcome, intervals_of_many};
use serde::Serialize;

use crate::block::{self, Block, Rows, Section, Table, cell};
use crate::subject::{Subject, agree, pluralise};

/// Results of a campaign of LIBERO's family or of a suite file, under one protocol.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Family {
    pub campaign: String,
    pub policy: String,
    /// The benchmark, or the name of the suite file.
    pub benchmark: String,
    /// Name of the protocol, or of the suite file with the first digits of its digest.
    pub protocol: String,
    /// Rollouts of the campaign, perturbed and unperturbed, without an outcome so far.
    pub missing: u64,
    /// Quarantined rollouts, which are in no figure.
    pub quarantined: u64,
    /// True if variants are paired with unperturbed rollouts.
    #[serde(skip)]
    pub is_paired: bool,
    pub unperturbed: Line,
    /// LIBERO-Para's types by their first name: `obj`, `act`, `comp`; empty for another benchmark.
    pub kinds: Vec<Line>,
    /// Dimensions of LIBERO-Plus, suites of LIBERO-PRO, or the first two names of LIBERO-Para's
    /// types, in the benchmark's order, or suites of a suite file by name.
    pub groups: Vec<Line>,
    /// Difficulties of LIBERO-Plus; variants without a difficulty are in the last line.
    pub difficulties: Vec<Line>,
    /// Difficulties within each dimension of LIBERO-Plus, or the 43 types of LIBERO-Para.
    pub cells: Vec<Line>,
    /// All variants together, as the benchmark's total counts them.
    pub all: Line,
    /// LIBERO-Para's score over all sentences; empty for another benchmark.
    pub pride: Vec<Pride>,
    /// Policies of the benchmark's published table, if the protocol is that table's.
    pub published: Vec<PublishedRow>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PublishedRow {
    pub policy: String,
    /// Successes over all variants of each dimension, per cent.
    pub percent: BTreeMap<&'static str, f64>,
}

/// A row of the tables.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Dimension, suite, type or difficulty; `unperturbed`, or `all`.
    pub name: String,
    pub tasks: u64,
    pub rollouts: u64,
    pub successes: u64,
    /// Successes over rollouts, per cent, as in the benchmark's table.
    pub percent: Option<f64>,
    /// 95 % interval of `percent`, by a bootstrap over tasks.
    pub interval: Option<Interval>,
    pub no_interval: Option<NoInterval>,
    /// Rollouts with an outcome whose unperturbed rollout has an outcome, too.
    pub pairs: u64,
    /// Failed rollouts whose unperturbed rollout succeeds.
    pub broken: u64,
    /// Successful rollouts whose unperturbed rollout fails.
    pub gained: u64,
    /// `broken` less `gained`, per cent of the pairs.
    pub loss: Option<f64>,
    /// 95 % interval of `loss`.
    pub loss_interval: Option<Interval>,
    pub no_loss_interval: Option<NoInterval>,
}

/// Failure to report on a campaign of LIBERO's family or of a suite file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FamilyError {
    #[error("report on campaign `{campaign}`")]
    Rollout { campaign: String, source: SelectionError },
    #[error("report on campaign `{campaign}`")]
    Protocol { campaign: String, source: UnknownName },
}

/// A rollout with an outcome.
pub(crate) struct Counted {
    pub(crate) case: Case,
    pub(crate) success: bool,
    /// Success of the unperturbed rollout from the same state, if it has an outcome.
    pub(crate) unperturbed_success: Option<bool>,
}

/// Sums over the rollouts of a task.
#[derive(Clone, Copy, Default)]
struct Sums {
    rollouts: u64,
    successes: u64,
    pairs: u64,
    broken: u64,
    gained: u64,
}

impl Sums {
    fn add(&mut self, rollout: &Counted) {
        self.rollouts += 1;
        self.successes += u64::from(rollout.success);
        self.pairs += u64::from(rollout.unperturbed_success.is_some());
        self.broken += u64::from(!rollout.success && rollout.unperturbed_success == Some(true));
        self.gained += u64::from(rollout.success && rollout.unperturbed_success == Some(false));
    }

    /// Returns the sums with each task counted as often as it was drawn.
    fn weighted(tasks: &[Self], draws: impl Fn(usize) -> u64) -> Self {
        let mut sum = Self::default();
        for (index, task) in tasks.iter().enumerate() {
            let draws = draws(index);
            sum.rollouts += draws * task.rollouts;
            sum.successes += draws * task.successes;
            sum.pairs += draws * task.pairs;
            sum.broken += draws * task.broken;
            sum.gained += draws * task.gained;
        }
        sum
    }

    fn percent(&self) -> Option<f64> {
        let percent = || 100.0 * self.successes as f64 / self.rollouts as f64;
        (self.rollouts > 0).then(percent)
    }

    fn loss(&self) -> Option<f64> {
        let net = self.broken as f64 - self.gained as f64;
        (self.pairs > 0).then(|| 100.0 * net / self.pairs as f64)
    }
}

impl Line {
    pub(crate) fn new<'a>(name: &str, counted: impl Iterator<Item = &'a Counted>) -> Self {
        let mut by_task: BTreeMap<TaskRef, Sums> = BTreeMap::new();
        for rollout in counted {
            by_task.entry(rollout.case.task).or_default().add(rollout);
        }
        let tasks: Vec<Sums> = by_task.into_values().collect();
        let sum = Sums::weighted(&tasks, |_| 1);
        let bootstrap = Bootstrap::default();
        let intervals = intervals_of_many(&bootstrap, tasks.len(), 2, |draws, values| {
            let drawn = Sums::weighted(&tasks, |index| u64::from(draws[index]));
            values[0] = drawn.percent().unwrap_or_default();
            values[1] = drawn.loss().unwrap_or_default();
        });
        let (percent_interval, loss_interval) = (intervals[0], intervals[1]);
        let has_pairs = sum.pairs > 0;
        Self {
            name: name.to_owned(),
            tasks: tasks.len() as u64,
            rollouts: sum.rollouts,
            successes: sum.successes,
            percent: sum.percent(),
            interval: percent_interval.ok(),
            no_interval: percent_interval.err(),
            pairs: sum.pairs,
            broken: sum.broken,
            gained: sum.gained,
            loss: sum.loss(),
            loss_interval: loss_interval.ok().filter(|_| has_pairs),
            no_loss_interval: loss_interval.err().filter(|_| has_pairs),
        }
    }
}

impl Family {
    /// Returns the section of the page.
    pub(crate) fn section(&self) -> Section<'_> {
        Section { title: self.title(), blocks: self.blocks(true) }
    }

    fn title(&self) -> String {
        match self.is_paired {
            true => format!("{} under protocol {}", self.benchmark, self.protocol),
            false => format!("Suite file {}", self.protocol),
        }
    }

    /// Returns the report; `is_full` adds the lines of `cells` and the published table.
    fn blocks(&self, is_full: bool) -> Vec<Block<'_>> {
        let unperturbed = [&self.unperturbed].into_iter().filter(|_| self.is_paired);
        let lines = self.lines(is_full);
        let all_lines = unperturbed.chain(lines.iter().copied());
        let successes = Rows::new("Successes", all_lines)
            .key("variants", |line| cell(&line.name))
            .column("rollouts", "", "", |line| cell(line.rollouts))
            .column("successes", "", "", |line| cell(line.successes))
            .column(
                "percent",
                "",
                "successes over rollouts, as in the benchmark's table; the last line counts all \
                 variants together",
                |line| cell(number(line.percent)),
            )
            .column("95 % interval", "", "resamples whole tasks", |line| {
                cell(interval(line.interval, line.no_interval))
            });
        let pride = Rows::new("PRIDE", &self.pride)
            .key("weight", |pride| cell(pride.name()))
            .column("percent", "", "", |pride| cell(number(pride.percent)))
            .column("95 % interval", "", "resamples whole tasks", |pride| {
                cell(interval(pride.interval, pride.no_interval))
            })
            .note("obj, act, comp", "other words for the object, for the action, for both")
            .note(
                "PRIDE",
                "sum of the distances from the task's instruction of the sentences that succeed, \
                 per cent of the sum over all sentences; α is the weight of the content words in a \
                 distance, and 1 − α that of the sentence's structure",
            );
        let losses = lines.into_iter().filter(|_| self.is_paired);
        let losses = Rows::new("Against the unperturbed rollouts", losses)
            .key("variants", |line| cell(&line.name))
            .column("pairs", "", "", |line| cell(line.pairs))
            .column(
                "broken",
                "",
                "failed, and the unperturbed rollout of its task from the same initial state \
                 succeeds",
                |line| cell(line.broken),
            )
            .column("gained", "", "the reverse of broken", |line| cell(line.gained))
            .column("loss", "", "broken less gained, per cent of the pairs", |line| {
                cell(number(line.loss))
            })
            .column("95 % interval", "", "resamples whole tasks", |line| {
                cell(interval(line.loss_interval, line.no_loss_interval))
            });
        let caveats = self.caveats().into_iter().map(Block::Paragraph);
        let tables = [successes.table(), pride.table(), losses.table()];
        let mut blocks: Vec<Block<'_>> = caveats.chain(tables.map(Block::Table)).collect();
        if is_full && !self.published.is_empty() {
            blocks.push(Block::Table(self.published_table()));
        }
        blocks
    }

    /// Reports on a campaign; `None` if it is neither of LIBERO's family nor of a suite file.
    pub fn of(subject: &Subject) -> Result<Option<Self>, FamilyError> {
        let Some(protocol) = &subject.protocol else {
            return Ok(None);
        };
        let campaign = subject.origin_name().to_owned();
        // The protocol of a suite file is `NAME@DIGEST`. Suite files have no unperturbed rollouts.
        let suite_file = protocol.split_once('@').map(|(name, _)| name.to_owned());
        let benchmark_protocol: Option<Protocol> = match suite_file {
            Some(_) => None,
            None => {
                let parsed: Result<Protocol, UnknownName> = protocol.parse();
                Some(parsed.map_err(|source| FamilyError::Protocol {
                    campaign: campaign.clone(),
                    source,
                })?)
            }
        };
        let benchmark = benchmark_protocol.map(|protocol| protocol.benchmark);
        let mut cases = Vec::new();
        for record in &subject.records {
            let case = Case::of_id(record.id)
                .map_err(|source| FamilyError::Rollout { campaign: campaign.clone(), source })?;
            cases.push((case, record.replicate, record.outcome));
        }
        let count =
            |expected| cases.iter().filter(|(_, _, outcome)| *outcome == expected).count() as u64;
        let state = |case: &Case, replicate| (case.task, case.trial, replicate);
        let unperturbed_success: BTreeMap<(TaskRef, u16, u32), bool> = cases
            .iter()
            .filter(|(case, ..)| case.subject == CaseSubject::Unperturbed)
            .filter_map(|(case, replicate, outcome)| {
                Some((state(case, *replicate), outcome.success()?))
            })
            .collect();
        let counted = cases.iter().filter_map(|(case, replicate, outcome)| {
            let unperturbed_success = unperturbed_success.get(&state(case, *replicate)).copied();
            Some(Counted { case: *case, success: outcome.success()?, unperturbed_success })
        });
        let (unperturbed, variants): (Vec<Counted>, Vec<Counted>) =
            counted.partition(|rollout| rollout.case.subject == CaseSubject::Unperturbed);
        let mut groups: BTreeMap<_, Vec<&Counted>> = BTreeMap::new();
        let mut difficulties: BTreeMap<_, Vec<&Counted>> = BTreeMap::new();
        let mut cells: BTreeMap<_, Vec<&Counted>> = BTreeMap::new();
        let mut kinds: BTreeMap<_, Vec<&Counted>> = BTreeMap::new();
        for variant in &variants {
            let (place, group) = group(&variant.case);
            groups.entry((place, group.clone())).or_default().push(variant);
            match variant.case.subject {
                CaseSubject::Plus(_) => {
                    // Variants without a difficulty come last.
                    let difficulty = variant.case.difficulty().unwrap_or(u8::MAX);
                    difficulties.entry(difficulty).or_default().push(variant);
                    let name = format!("{group} {}", difficulty_name(difficulty));
                    let cell = cells.entry((place, difficulty, name)).or_default();
                    cell.push(variant);
                }
                CaseSubject::Para(paraphrase) => {
                    let kind = paraphrase.kind;
                    let high = (place_of(|other| other.high() == kind.high()), kind.high());
                    kinds.entry(high).or_default().push(variant);
                    let place = place_of(|other| other == kind);
                    let cell = cells.entry((place, 0, kind.title())).or_default();
                    cell.push(variant);
                }
                _ => {}
            }
        }
        let paraphrased = variants.iter().filter_map(|variant| match variant.case.subject {
            CaseSubject::Para(paraphrase) => Some((
                variant.case.task,
                Paraphrased {
                    success: variant.success,
                    keywords: paraphrase.keywords,
                    structure: paraphrase.structure,
                },
            )),
            _ => None,
        });
        let line = |name: &str, rollouts: &[&Counted]| Line::new(name, rollouts.iter().copied());
        Ok(Some(Self {
            campaign,
            policy: subject.policy.clone(),
            benchmark: match benchmark {
                Some(benchmark) => benchmark.to_string(),
                None => suite_file.unwrap_or_default(),
            },
            protocol: protocol.clone(),
            is_paired: benchmark.is_some(),
            missing: count(Outcome::Missing),
            quarantined: count(Outcome::Quarantined),
            unperturbed: Line::new("unperturbed", unperturbed.iter()),
            kinds: kinds.iter().map(|((_, name), rollouts)| line(name, rollouts)).collect(),
            groups: groups.iter().map(|((_, name), rollouts)| line(name, rollouts)).collect(),
            difficulties: difficulties
                .iter()
                .map(|(difficulty, rollouts)| line(&difficulty_name(*difficulty), rollouts))
                .collect(),
            cells: cells.iter().map(|((_, _, name), rollouts)| line(name, rollouts)).collect(),
            all: Line::new("all", variants.iter()),
            pride: Pride::all(paraphrased),
            published: benchmark_protocol.map_or_else(Vec::new, |protocol| published(&protocol)),
        }))
    }

    /// Writes the short report for a terminal.
    pub(crate) fn brief(&self) -> String {
        let blocks = [Block::Heading(self.heading())].into_iter().chain(self.blocks(false));
        block::text(&blocks.collect::<Vec<_>>())
    }

    /// Returns the title of the text.
    pub(crate) fn heading(&self) -> String {
        format!("Campaign {} of policy {}: {}", self.campaign, self.policy, self.title())
    }

    /// Returns the row of this campaign, and the published rows.
    fn published_table(&self) -> Table {
        let measured = self.groups.iter().map(|line| (line.name.as_str(), line.percent));
        let measured = ("this campaign".to_owned(), measured.collect::<BTreeMap<_, _>>());
        let published = self.published.iter().map(|row| {
            let percent = row.percent.iter().map(|(name, percent)| (*name, Some(*percent)));
            (row.policy.clone(), percent.collect())
        });
        let name = format!(
            "Published: successes over all 10,030 variants, per cent ({PUBLISHED_SOURCE}). A \
             published figure is comparable with this campaign only for a dimension of which the \
             campaign ran all variants"
        );
        let mut rows = Rows::new(name, [measured].into_iter().chain(published))
            .key("policy", |(policy, _)| cell(policy));
        for name in Dimension::ALL.map(Dimension::name) {
            let value = |(_, percent): &(_, BTreeMap<&str, Option<f64>>)| {
                cell(number(percent.get(name).copied().flatten()))
            };
            rows = rows.column(name, "", "", value);
        }
        rows.table()
    }

    /// Returns the rows of variants, the total last.
    fn lines(&self, full: bool) -> Vec<&Line> {
        let cells = self.cells.iter().filter(|_| full);
        let lines = self.kinds.iter().chain(&self.groups);
        let lines = lines.chain(&self.difficulties).chain(cells);
        lines.chain([&self.all]).collect()
    }

    /// Returns sentences about rollouts that are in no figure.
    fn caveats(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        if self.missing > 0 {
            sentences.push(format!(
                "{} of the campaign {} no outcome so far.",
                pluralise(self.missing, "rollout"),
                agree(self.missing, "has", "have")
            ));
        }
        if self.quarantined > 0 {
            sentences.push(format!(
                "{} of the campaign {} quarantined and in no figure; `coordinator jobs` names \
                 {}.",
                pluralise(self.quarantined, "rollout"),
                agree(self.quarantined, "is", "are"),
                agree(self.quarantined, "it", "them")
            ));
        }
        sentences
    }
}

/// Returns the benchmark's published table; empty unless `protocol` is that of the table.
fn published(protocol: &Protocol) -> Vec<PublishedRow> {
    if *protocol != Protocol::PLUS_OFFICIAL {
        return Vec::new();
    }
    let names = Dimension::ALL.map(Dimension::name);
    let rows = PUBLISHED.iter().map(|row| PublishedRow {
        policy: row.policy.to_owned(),
        percent: names.into_iter().zip(row.percent).collect(),
    });
    rows.collect()
}

/// Returns the place of a variant's group in the benchmark's order, and the group's name.
pub(crate) fn group(case: &Case) -> (usize, String) {
    let place = match case.subject {
        CaseSubject::Unperturbed | CaseSubject::Own(_) => None,
        CaseSubject::Plus(entry) => {
            Dimension::ALL.into_iter().position(|dimension| dimension == entry.dimension())
        }
        CaseSubject::Pro(suite) => ProSuite::all().position(|other| other == suite),
        CaseSubject::Para(paraphrase) => {
            let kind = paraphrase.kind;
            let is_like = |other: Kind| other.high() == kind.high() && other.mid() == kind.mid();
            Some(place_of(is_like))
        }
    };
    (place.unwrap_or_default(), case.group().unwrap_or_default())
}

/// Returns the position of the first matching type of LIBERO-Para.
fn place_of(is_match: impl Fn(Kind) -> bool) -> usize {
    Kind::all().position(is_match).unwrap_or_default()
}

fn difficulty_name(difficulty: u8) -> String {
    match difficulty {
        u8::MAX => "difficulty not given".to_owned(),
        given => format!("difficulty {given}"),
    }
}

pub(crate) fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"))
}

pub(crate) fn interval(interval: Option<Interval>, reason: Option<NoInterval>) -> String {
    match (interval, reason) {
        (Some([low, high]), _) => format!("{low:.1} to {high:.1}"),
        (None, Some(reason)) => reason.to_string(),
        (None, None) => "-".to_owned(),
    }
}

/// Weights of the content words: 0.5 as in the released code, 0 for the structure alone, 1 for the
/// content words alone.
const ALPHAS: [f64; 3] = [0.5, 0.0, 1.0];

/// PRIDE with one weight of the content words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pride {
    /// Weight of the content words; the weight of the structure is 1 − `alpha`.
    pub alpha: f64,
    /// Successes, each weighted by the distance of its sentence from the task's instruction, per
    /// cent of the sum of all distances.
    pub percent: Option<f64>,
    /// 95 % interval of `percent`, by a bootstrap over tasks.
    pub interval: Option<Interval>,
    pub no_interval: Option<NoInterval>,
}

impl Pride {
    /// Returns the score of the rollouts with each weight; empty without rollouts.
    pub(crate) fn all(rollouts: impl Iterator<Item = (TaskRef, Paraphrased)>) -> Vec<Self> {
        let mut by_task: BTreeMap<TaskRef, [Distances; ALPHAS.len()]> = BTreeMap::new();
        for (task, outcome) in rollouts {
            let sums = by_task.entry(task).or_default();
            for (sum, alpha) in sums.iter_mut().zip(ALPHAS) {
                sum.add(&outcome, alpha);
            }
        }
        if by_task.is_empty() {
            return Vec::new();
        }
        let tasks: Vec<_> = by_task.into_values().collect();
        let pride = |index: usize, draws: &dyn Fn(usize) -> f64| {
            let mut sum = Distances::default();
            for (task, sums) in tasks.iter().enumerate() {
                sum.reached += draws(task) * sums[index].reached;
                sum.total += draws(task) * sums[index].total;
            }
            sum.pride()
        };
        let bootstrap = Bootstrap::default();
        let intervals =
            intervals_of_many(&bootstrap, tasks.len(), ALPHAS.len(), |draws, values| {
                for (index, value) in values.iter_mut().enumerate() {
                    let drawn = pride(index, &|task| f64::from(draws[task]));
                    *value = drawn.unwrap_or_default();
                }
            });
        let lines = ALPHAS.into_iter().zip(intervals).enumerate();
        lines
            .map(|(index, (alpha, interval))| Self {
                alpha,
                percent: pride(index, &|_| 1.0),
                interval: interval.ok(),
                no_interval: interval.err(),
            })
            .collect()
    }

    /// Returns the name in tables.
    pub(crate) fn name(&self) -> String {
        let weight = match self.alpha {
            0.0 => ", structure alone",
            1.0 => ", content words alone",
            _ => "",
        };
        format!("α {}{weight}", self.alpha)
    }
}
