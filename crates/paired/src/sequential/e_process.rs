//! E-process: evidence of the draws so far against each candidate for the population's
//! total. The proof is in `sequential`.

/// Sizes of the bets, each made on large and on small values. A size is the stake on the first
/// draw from a stratum of mean size; stakes grow as a stratum runs out ([`Stratum::stake`]). Each
/// size is nearly optimal for one width of the interval, from the width after a fifth of the
/// population to that after nine tenths; the average over all sizes is never far from the best.
const SIZES: [f64; 4] = [0.15, 0.25, 0.4, 0.7];

/// Largest share of the capital that a bet may lose on one draw.
const MAX_LOSS: f64 = 0.9;

/// Weight of the prior of the centre: a number of virtual draws with the middle value of
/// the range.
const PRIOR_DRAWS: f64 = 2.0;

/// Weight of the mean over all strata in a stratum's centre, in draws of the stratum.
/// The centre affects only the width of intervals, not their validity.
const POOLED_DRAWS: f64 = 10.0;

/// Log e-values of the candidates for the total of a stratified finite population
/// with bounded integer values.
///
/// The value of a unit may be known only as a range; each bet then uses the value that
/// minimises its e-value.
#[derive(Clone, Debug)]
pub(crate) struct EProcess {
    /// Least and greatest value of a unit.
    range: [i64; 2],
    /// Mean number of units of a stratum.
    mean_size: f64,
    strata: Vec<Stratum>,
    bets: Vec<Bet>,
}

pub(crate) struct EValues {
    /// Log e-values of each bet, from the least possible total to the greatest.
    logs: Vec<Vec<f64>>,
}

impl EValues {
    /// Returns the e-value of the candidate `above` units over the least possible total: the
    /// average over the bets.
    pub(crate) fn at(&self, above: usize) -> f64 {
        let sum: f64 = self.logs.iter().map(|log| log[above].exp()).sum();
        sum / self.logs.len() as f64
    }
}

/// Counts of the drawn and remaining units of a stratum.
#[derive(Clone, Debug)]
struct Stratum {
    remaining: i64,
    drawn: i64,
    /// Least and greatest sum that the drawn units can have.
    sum: [i64; 2],
}

/// A bet of one size, on large values or, if the size is negative, on small ones.
#[derive(Clone, Debug)]
struct Bet {
    size: f64,
    /// Log of the product of the numerators.
    gains: f64,
    /// For each stratum, minus the log of the product of the denominators, indexed by
    /// the stratum's total minus its initial least total.
    costs: Vec<Vec<f64>>,
}

impl Stratum {
    /// Returns the least and greatest total that is still possible.
    fn totals(&self, [least, greatest]: [i64; 2]) -> [i64; 2] {
        [self.sum[0] + least * self.remaining, self.sum[1] + greatest * self.remaining]
    }

    /// Returns the mean of the drawn units, shrunk towards the mean over all strata.
    fn centre(&self, pooled: f64) -> f64 {
        (middle(self.sum) + POOLED_DRAWS * pooled) / (self.drawn as f64 + POOLED_DRAWS)
    }

    /// Returns the stake of a bet on the next draw. It grows as fewer units remain, because
    /// a wrong total then shifts the expectation of the next unit further.
    fn stake(&self, size: f64, mean_size: f64, centre: f64, [least, greatest]: [i64; 2]) -> f64 {
        let stake = size * mean_size / self.remaining as f64;
        let max_stake = MAX_LOSS / (centre - least as f64);
        let min_stake = -MAX_LOSS / (greatest as f64 - centre);
        stake.clamp(min_stake, max_stake)
    }
}

impl EProcess {
    /// Creates the process before the first draw; `sizes` are the numbers of units of the
    /// strata.
    pub(crate) fn new(sizes: &[usize], range: [i64; 2]) -> Self {
        let strata =
            sizes.iter().map(|&size| Stratum { remaining: size as i64, drawn: 0, sum: [0, 0] });
        let totals = |&size: &usize| size * (range[1] - range[0]) as usize + 1;
        let bet = |size: f64| Bet {
            size,
            gains: 0.0,
            costs: sizes.iter().map(|size| vec![0.0; totals(size)]).collect(),
        };
        Self {
            range,
            mean_size: sizes.iter().sum::<usize>() as f64 / sizes.len() as f64,
            strata: strata.collect(),
            bets: SIZES.iter().flat_map(|&s| [bet(s), bet(-s)]).collect(),
        }
    }

    /// Adds a round: strata, each at most once, with the least and greatest possible value
    /// of the drawn unit.
    pub(crate) fn draw_round(&mut self, round: &[(usize, [i64; 2])]) {
        let pooled = self.pooled();
        for &(stratum, value) in round {
            self.draw(stratum, value, pooled);
        }
    }

    /// Returns the mean of all drawn units and the virtual prior draws.
    fn pooled(&self) -> f64 {
        let sum: f64 = self.strata.iter().map(|stratum| middle(stratum.sum)).sum();
        let drawn: i64 = self.strata.iter().map(|stratum| stratum.drawn).sum();
        (sum + PRIOR_DRAWS * middle(self.range)) / (drawn as f64 + PRIOR_DRAWS)
    }

    fn draw(&mut self, index: usize, value: [i64; 2], pooled: f64) {
        let stratum = &self.strata[index];
        let centre = stratum.centre(pooled);
        let [lowest, highest] = stratum.totals(self.range);
        let initial_least = self.range[0] * (stratum.drawn + stratum.remaining);
        for bet in &mut self.bets {
            let stake = stratum.stake(bet.size, self.mean_size, centre, self.range);
            // The e-value is smallest at the least value if the bet is on large values and
            // at the greatest otherwise, for this draw and all earlier ones.
            let worst = usize::from(stake < 0.0);
            bet.gains += (stake * (value[worst] as f64 - centre)).ln_1p();
            for total in lowest..=highest {
                let remaining_sum = (total - stratum.sum[worst]) as f64;
                let expected = remaining_sum / stratum.remaining as f64;
                bet.costs[index][(total - initial_least) as usize] -=
                    (stake * (expected - centre)).ln_1p();
            }
        }
        let stratum = &mut self.strata[index];
        stratum.drawn += 1;
        stratum.remaining -= 1;
        stratum.sum[0] += value[0];
        stratum.sum[1] += value[1];
    }

    pub(crate) fn e_values(&self) -> EValues {
        EValues { logs: self.bets.iter().map(|bet| self.log_capital(bet)).collect() }
    }

    /// Returns the log of one bet's capital, by candidate, minimised over the strata's
    /// totals.
    ///
    /// Costs are convex in each stratum's total. The best totals for a candidate are
    /// therefore those of the previous candidate with one more unit in the cheapest
    /// stratum: the steps of all strata in ascending order. Source: T. Ibaraki
    /// and N. Katoh, Resource Allocation Problems (1988), section 4.2.
    fn log_capital(&self, bet: &Bet) -> Vec<f64> {
        let mut log = bet.gains;
        let mut steps = Vec::new();
        for (stratum, costs) in self.strata.iter().zip(&bet.costs) {
            let initial_least = self.range[0] * (stratum.drawn + stratum.remaining);
            let [lowest, highest] =
                stratum.totals(self.range).map(|t| (t - initial_least) as usize);
            log += costs[lowest];
            steps.extend(costs[lowest..=highest].windows(2).map(|pair| pair[1] - pair[0]));
        }
        // The steps of each stratum are already sorted, which makes the stable sort fast.
        steps.sort_by(f64::total_cmp);
        let mut logs = vec![log];
        for step in steps {
            log += step;
            logs.push(log);
        }
        logs
    }
}

fn middle([least, greatest]: [i64; 2]) -> f64 {
    (least + greatest) as f64 / 2.0
}

/// Range of totals that are not ruled out, updated after each draw.
#[derive(Clone, Debug)]
pub(crate) struct ConfidenceSequence {
    process: EProcess,
    alpha: f64,
    /// Least and greatest total that neither the e-process (at any look) nor the drawn
    /// values rule out.
    totals: [i64; 2],
    /// Least and greatest total that the drawn values allow.
    possible: [i64; 2],
    /// Least and greatest value of a unit.
    range: [i64; 2],
    /// Draws of the current, incomplete round.
    round: Vec<(usize, [i64; 2])>,
}

impl ConfidenceSequence {
    /// Creates the sequence of a population with strata of `sizes` and values in `range`. The
    /// probability that the interval ever excludes the true total is at most `alpha`.
    pub(crate) fn new(sizes: &[usize], range: [i64; 2], alpha: f64) -> Self {
        let units = sizes.iter().sum::<usize>() as i64;
        let possible = range.map(|end| end * units);
        Self {
            process: EProcess::new(sizes, range),
            alpha,
            totals: possible,
            possible,
            range,
            round: Vec::new(),
        }
    }

    /// Adds the next unit: its stratum, and its least and greatest possible value.
    pub(crate) fn draw(&mut self, stratum: usize, value: [i64; 2]) {
        self.round.push((stratum, value));
        for end in [0, 1] {
            self.possible[end] += value[end] - self.range[end];
        }
        self.clamp_totals();
    }

    /// Ends a round and updates the totals from the e-process. Updating after every draw
    /// would be valid too, but a partial round excludes few candidates: a candidate's total may be
    /// due to the strata that the round has not reached.
    pub(crate) fn end_round(&mut self) {
        self.process.draw_round(&std::mem::take(&mut self.round));
        let e_values = self.process.e_values();
        let least = self.possible[0];
        let is_kept = |total: &i64| e_values.at((total - least) as usize) * self.alpha < 1.0;
        let [low, high] = self.totals;
        // E-values are convex in the total, so that the kept totals have no gaps. If none is kept,
        // the true total is ruled out, now or before, and the interval stays unchanged.
        if let Some(low) = (low..=high).find(is_kept) {
            let high = (low..=high).rev().find(is_kept).unwrap_or(low);
            self.totals = [low, high];
        }
    }

    fn clamp_totals(&mut self) {
        let [least, greatest] = self.possible;
        self.totals = self.totals.map(|end| end.clamp(least, greatest));
    }

    /// Returns the least and greatest total that are not ruled out.
    pub(crate) fn totals(&self) -> [i64; 2] {
        self.totals
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit: its true value and the range reported for it.
    type Unit = (i64, [i64; 2]);

    /// The units of each stratum.
    type Strata = Vec<Vec<Unit>>;

    /// Returns every order of a stratum's units.
    fn permutations(units: &[Unit]) -> Vec<Vec<Unit>> {
        if units.is_empty() {
            return vec![Vec::new()];
        }
        let mut all = Vec::new();
        for i in 0..units.len() {
            let mut rest = units.to_vec();
            let first = rest.remove(i);
            for mut order in permutations(&rest) {
                order.insert(0, first);
                all.push(order);
            }
        }
        all
    }

    /// Returns every multiset of `size` units of some kinds.
    fn multisets(kinds: &[Unit], size: usize) -> Vec<Vec<Unit>> {
        if size == 0 {
            return vec![Vec::new()];
        }
        let mut all = Vec::new();
        for i in 0..kinds.len() {
            for mut rest in multisets(&kinds[i..], size - 1) {
                rest.push(kinds[i]);
                all.push(rest);
            }
        }
        all
    }

    /// Returns the Cartesian product of the choices for each stratum.
    fn combinations(choices: &[Vec<Vec<Unit>>]) -> Vec<Strata> {
        let mut all = vec![Vec::new()];
        for choices in choices {
            let mut longer = Vec::new();
            for strata in all {
                for choice in choices {
                    let mut strata: Strata = strata.clone();
                    strata.push(choice.clone());
                    longer.push(strata);
                }
            }
            all = longer;
        }
        all
    }

    /// Returns the units drawn in each round: the stratum and the bounds of the
    /// value.
    fn rounds(strata: &Strata) -> Vec<Vec<(usize, [i64; 2])>> {
        let longest = strata.iter().map(Vec::len).max().unwrap_or_default();
        let units_of_round = |round: usize| {
            let drawn = strata.iter().enumerate();
            let drawn = drawn.filter_map(|(k, units)| Some((k, units.get(round)?.1)));
            drawn.collect()
        };
        (0..longest).map(units_of_round).collect()
    }

    fn total(strata: &Strata) -> i64 {
        strata.iter().flatten().map(|(value, _)| value).sum()
    }

    fn true_e_values(strata: &Strata, sizes: &[usize], range: [i64; 2]) -> Vec<f64> {
        let mut process = EProcess::new(sizes, range);
        let mut least = sizes.iter().sum::<usize>() as i64 * range[0];
        let after = |round: Vec<(usize, [i64; 2])>| {
            process.draw_round(&round);
            least += round.iter().map(|(_, value)| value[0] - range[0]).sum::<i64>();
            process.e_values().at((total(strata) - least) as usize)
        };
        rounds(strata).into_iter().map(after).collect()
    }

    /// Returns true if the true total is in the interval at all looks.
    fn holds(strata: &Strata, sizes: &[usize], range: [i64; 2], alpha: f64) -> bool {
        let mut sequence = ConfidenceSequence::new(sizes, range, alpha);
        rounds(strata).into_iter().all(|round| {
            for (stratum, value) in round {
                sequence.draw(stratum, value);
            }
            sequence.end_round();
            let [low, high] = sequence.totals();
            (low..=high).contains(&total(strata))
        })
    }

    const ALPHAS: [f64; 4] = [0.2, 0.4, 0.6, 0.8];

    /// Enumerates every population of some kinds of units and all its orders, and asserts
    /// that the e-value of the true total has an expectation of at most 1 after each round
    /// and that the interval ever excludes the true total with a probability of at most α.
    /// Returns the greatest of these probabilities.
    fn check_coverage(range: [i64; 2], kinds: &[Unit], sizes: &[usize]) -> f64 {
        let mut greatest: f64 = 0.0;
        let strata: Vec<_> = sizes.iter().map(|&size| multisets(kinds, size)).collect();
        for population in combinations(&strata) {
            let orders: Vec<_> = population.iter().map(|units| permutations(units)).collect();
            let orders = combinations(&orders);
            let count = orders.len() as f64;
            let mut sums = vec![0.0; rounds(&population).len()];
            for order in &orders {
                let e_values = true_e_values(order, sizes, range);
                sums.iter_mut().zip(e_values).for_each(|(sum, e)| *sum += e);
            }
            for sum in sums {
                assert!(sum / count <= 1.0 + 1e-12, "{population:?}: {}", sum / count);
            }
            for alpha in ALPHAS {
                let missed = orders.iter().filter(|order| !holds(order, sizes, range, alpha));
                let missed = missed.count() as f64 / count;
                assert!(missed <= alpha, "{population:?}: {missed} at {alpha}");
                greatest = greatest.max(missed);
            }
        }
        greatest
    }

    const RATE: [Unit; 2] = [(0, [0, 0]), (1, [1, 1])];
    const DIFFERENCE: [Unit; 3] = [(-1, [-1, -1]), (0, [0, 0]), (1, [1, 1])];
    /// Kinds of units, two of them quarantined: their values are unknown.
    const QUARANTINE: [Unit; 4] = [(0, [0, 0]), (1, [1, 1]), (0, [0, 1]), (1, [0, 1])];

    #[test]
    fn rates_are_covered_over_all_orders_of_all_small_populations() {
        for sizes in [&[3, 3, 3][..], &[4, 4], &[6]] {
            let missed = check_coverage([0, 1], &RATE, sizes);
            assert!(
                missed > 0.0,
                "{sizes:?}: no interval ever excludes the total, so that the test shows nothing"
            );
        }
    }

    #[test]
    fn differences_are_covered_over_all_orders_of_all_small_populations() {
        for sizes in [&[3, 3][..], &[2, 2, 2], &[5]] {
            let missed = check_coverage([-1, 1], &DIFFERENCE, sizes);
            assert!(
                missed > 0.0,
                "{sizes:?}: no interval ever excludes the total, so that the test shows nothing"
            );
        }
    }

    #[test]
    fn totals_over_strata_of_unequal_sizes_are_covered() {
        assert!(check_coverage([0, 1], &RATE, &[5, 2, 1]) > 0.0);
        assert!(check_coverage([-1, 1], &DIFFERENCE, &[4, 2]) > 0.0);
    }

    #[test]
    fn totals_with_quarantined_units_are_covered() {
        assert!(check_coverage([0, 1], &QUARANTINE, &[5]) > 0.0);
        check_coverage([0, 1], &QUARANTINE, &[3, 3]);
    }
}
