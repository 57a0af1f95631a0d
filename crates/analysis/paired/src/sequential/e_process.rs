//! Evidence of the draws so far against each candidate for the population's total.
//! The proof is in `sequential`.

/// Sizes of bets, for and against: relative to the values' unit, and made
/// larger as a stratum runs out ([`Stratum::stake`]). Each is about best for one
/// width of the interval, from that of a fifth of the population to that of nine
/// tenths; the average of all is never far from the best.
const SIZES: [f64; 4] = [0.15, 0.25, 0.4, 0.7];

/// Most of the capital that a bet may lose on one draw.
const MOST_LOST: f64 = 0.9;

/// Draws of value halfway between least and greatest, as which the centre counts
/// what it knows before the first draw.
const PRIOR_DRAWS: f64 = 2.0;

/// As how many draws of a stratum the mean over all strata counts in its centre.
/// The centre decides only how narrow intervals are, not whether they hold.
const POOLED_DRAWS: f64 = 10.0;

/// Log e-values of the candidates for the total of a finite population in
/// strata, whose units have whole values between a least and a greatest one.
///
/// Units whose value is known only as a range are allowed: for every bet, the
/// value is taken that makes its e-value least.
#[derive(Clone, Debug)]
pub(crate) struct EProcess {
    /// Least and greatest value of a unit.
    range: [i64; 2],
    mean_size: f64,
    strata: Vec<Stratum>,
    bets: Vec<Bet>,
}

/// E-values by candidate.
pub(crate) struct EValues {
    /// For each bet, the logs: from the least total that is still possible to the
    /// greatest.
    logs: Vec<Vec<f64>>,
}

impl EValues {
    /// The e-value of the candidate that is `above` the least total that is still
    /// possible: the average over the bets.
    pub(crate) fn at(&self, above: usize) -> f64 {
        let sum: f64 = self.logs.iter().map(|log| log[above].exp()).sum();
        sum / self.logs.len() as f64
    }
}

/// Units of a stratum, drawn and remaining.
#[derive(Clone, Debug)]
struct Stratum {
    remaining: i64,
    drawn: i64,
    /// Least and greatest sum that the drawn units can have.
    seen: [i64; 2],
}

/// One size of bet, for or against.
#[derive(Clone, Debug)]
struct Bet {
    size: f64,
    /// Log of the product of the numerators.
    gains: f64,
    /// For each stratum, minus the log of the product of the denominators, by
    /// the stratum's total less the least one that it could have at first.
    costs: Vec<Vec<f64>>,
}

impl Stratum {
    /// Least and greatest total that is still possible.
    fn totals(&self, [least, greatest]: [i64; 2]) -> [i64; 2] {
        [
            self.seen[0] + least * self.remaining,
            self.seen[1] + greatest * self.remaining,
        ]
    }

    /// The mean of its drawn units, drawn towards that of all strata.
    fn centre(&self, pooled: f64) -> f64 {
        (middle(self.seen) + POOLED_DRAWS * pooled) / (self.drawn as f64 + POOLED_DRAWS)
    }

    /// Returns the stake of a bet on the next draw. The fewer units remain, the
    /// further a wrong total moves the expectation of the next.
    fn stake(&self, size: f64, mean_size: f64, centre: f64, [least, greatest]: [i64; 2]) -> f64 {
        let stake = size * mean_size / self.remaining as f64;
        let most = MOST_LOST / (centre - least as f64);
        let least = -MOST_LOST / (greatest as f64 - centre);
        stake.clamp(least, most)
    }
}

impl EProcess {
    /// Before the first draw, with the numbers of units of the strata.
    pub(crate) fn new(sizes: &[usize], range: [i64; 2]) -> Self {
        let strata = sizes.iter().map(|&size| Stratum {
            remaining: size as i64,
            drawn: 0,
            seen: [0, 0],
        });
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

    /// Takes a round: strata, each at most once, and the least and greatest value
    /// that their unit can have.
    pub(crate) fn draw_round(&mut self, round: &[(usize, [i64; 2])]) {
        let pooled = self.pooled();
        for &(stratum, value) in round {
            self.draw(stratum, value, pooled);
        }
    }

    /// The mean of all drawn units.
    fn pooled(&self) -> f64 {
        let seen: f64 = self.strata.iter().map(|it| middle(it.seen)).sum();
        let drawn: i64 = self.strata.iter().map(|it| it.drawn).sum();
        (seen + PRIOR_DRAWS * middle(self.range)) / (drawn as f64 + PRIOR_DRAWS)
    }

    fn draw(&mut self, index: usize, value: [i64; 2], pooled: f64) {
        let stratum = &self.strata[index];
        let centre = stratum.centre(pooled);
        let [lowest, highest] = stratum.totals(self.range);
        let first = self.range[0] * (stratum.drawn + stratum.remaining);
        for bet in &mut self.bets {
            let stake = stratum.stake(bet.size, self.mean_size, centre, self.range);
            // The least e-value is that of the least value if the bet is on great
            // ones, and of the greatest otherwise, now and in all earlier draws.
            let worst = usize::from(stake < 0.0);
            bet.gains += (stake * (value[worst] as f64 - centre)).ln_1p();
            for total in lowest..=highest {
                let left = (total - stratum.seen[worst]) as f64;
                let expected = left / stratum.remaining as f64;
                bet.costs[index][(total - first) as usize] -= (stake * (expected - centre)).ln_1p();
            }
        }
        let stratum = &mut self.strata[index];
        stratum.drawn += 1;
        stratum.remaining -= 1;
        stratum.seen[0] += value[0];
        stratum.seen[1] += value[1];
    }

    /// The e-values of all candidates.
    pub(crate) fn e_values(&self) -> EValues {
        EValues {
            logs: self.bets.iter().map(|bet| self.least(bet)).collect(),
        }
    }

    /// The log of one bet's capital, by candidate, for the strata's totals that
    /// make it least.
    ///
    /// Costs are convex in each stratum's total. So the best totals for a
    /// candidate are those for the candidate before, with one more where that is
    /// cheapest: the steps of all strata, in ascending order. Source: T. Ibaraki
    /// and N. Katoh, Resource Allocation Problems (1988), section 4.2.
    fn least(&self, bet: &Bet) -> Vec<f64> {
        let mut log = bet.gains;
        let mut steps = Vec::new();
        for (stratum, costs) in self.strata.iter().zip(&bet.costs) {
            let first = self.range[0] * (stratum.drawn + stratum.remaining);
            let [lowest, highest] = stratum.totals(self.range).map(|t| (t - first) as usize);
            log += costs[lowest];
            steps.extend(costs[lowest..=highest].windows(2).map(|it| it[1] - it[0]));
        }
        // The steps of each stratum are in order already, which a stable sort uses.
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
