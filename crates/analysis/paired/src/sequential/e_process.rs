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

/// E-values by candidate.
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

    /// Returns the e-values of all candidates.
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
