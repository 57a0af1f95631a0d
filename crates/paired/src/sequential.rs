//! Confidence sequences: intervals that stay valid for a campaign that is
//! monitored while it runs and may end as soon as they are narrow enough.
//!
//! # Estimand
//! The configurations of one level are a finite population of N units in strata
//! (tasks or suites). Units are drawn without replacement, one of every stratum in each
//! round ([`Order`]). An interval is about the value over *all* N units, drawn or
//! not, so that it shrinks to a point when all units are drawn.
//!
//! # Guarantee
//! With probability 95 % over the drawn order, *every* interval of a
//! [`SequentialMeasures`] holds at *every* look. An operator may therefore look at
//! any time, stop for any reason, and read any of the five intervals. Intervals for
//! a fixed sample size, such as a bootstrap's, do not allow this.
//!
//! # Proof
//! Let stratum k have m_k units, of which r_k remain, with values x and the
//! total T_k. The next unit drawn has the expectation
//! p_k(T_k) = (T_k − sum of the drawn units of stratum k) / r_k. For numbers s (a bet) and
//! c (a centre) that depend on the past alone, the factor
//! (1 + s·(x − c)) / (1 + s·(p_k(T_k) − c)) has the expectation 1. The product
//! of the factors of all draws, M(T_1, …, T_K), is therefore a nonnegative
//! martingale, and so is its average over several sizes of bets.
//!
//! The totals of the strata are unknown nuisance parameters. The evidence against a
//! candidate θ for the population's total is the evidence against the best-supported strata
//! totals that sum to θ: E(θ) = min {M(T_1, …, T_K): Σ T_k = θ}. At the true total, E is at
//! most the martingale at the true totals of strata. By Ville's inequality, the probability
//! that E ever reaches 1/α is at most α, so that {θ: E(θ) < 1/α} contains the true total at
//! all looks simultaneously with a probability of at least 1 − α. For each bet, −log of the
//! denominators is convex in each T_k, so that the minimum is found exactly, for one
//! candidate θ after the other (the file `e_process`).
//!
//! The five measures share α = 5 % equally (Bonferroni).
//!
//! # Choice of strata
//! Strata must be chosen before any outcome is known. With fewer strata, the minimum over their
//! totals discards less evidence and the rounds are shorter. Strata of suites therefore give
//! narrower intervals than strata of tasks, unless tasks of a suite differ very much, and keep the
//! sample balanced over suites.
//!
//! # Sources
//! I. Waudby-Smith and A. Ramdas, Confidence sequences for sampling without
//! replacement, NeurIPS 2020 (conditional expectations, running intersection);
//! the same, Estimating means of bounded random variables by betting, JRSS B 86
//! (2024), 1–27 (bets); J. V. Spertus, M. Sridhar and P. B. Stark, Sequential
//! stratified inference for the mean, arXiv 2409.06680 (strata's means as
//! nuisance parameters, over which the evidence is minimised); J. Ville, Étude critique de
//! la notion de collectif (1939).

mod campaign;
mod e_process;
mod measures;
mod non_inferiority;
mod order;

pub use campaign::{CampaignLook, SEQUENTIAL_ALPHA, drawn_order};
pub use measures::{Look, RateInterval, SequentialMeasures};
pub use non_inferiority::{Bisection, ConditionEvidence, NonInferiority, Verdict};
pub use order::{Drawn, Order, Unit};
