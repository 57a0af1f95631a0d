//! Rate of rollouts of one kind on a set of workers, and its bottleneck. Pure functions.
//!
//! A rate has three upper bounds, and the smallest applies. A slot runs one rollout at a time, from
//! start to end. A worker's slots share its cores, on which physics and rendering take processor
//! time. The policy's server answers a limited number of queries per second. These are the
//! asymptotic bounds of a closed queueing network; random waiting lowers the actual rate, so the
//! result is a best case.

/// Slots and cores of a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Machine {
    /// Rollouts that run concurrently.
    pub(super) slots: u32,
    /// Cores that the slots share.
    pub(super) cores: u32,
}

/// Mean times of one rollout, seconds, and its mean number of policy queries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// Processor time of the physics.
    pub physics_secs: f64,
    /// Processor time of rendering.
    pub drawing_secs: f64,
    /// Time waiting for the policy's answers.
    pub policy_secs: f64,
    /// Remaining part of the duration: waiting for a core, a graphics card or a disk.
    pub waiting_secs: f64,
    /// Part of the waiting time that slots with a core of their own lost to another resource, such
    /// as a disk; additional slots would lose it as well.
    pub taken_secs: f64,
    pub queries: f64,
}

/// The bound that limits a rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bottleneck {
    /// More slots would raise the rate.
    Slots,
    /// Every core is busy.
    Cores,
    /// The policy's server is saturated.
    Policy,
}

/// Rate of rollouts, and the slots that would raise it to its highest value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    pub per_sec: f64,
    /// The bound that limits the rate.
    pub bottleneck: Bottleneck,
    /// Fewest slots that reach the highest rate.
    pub enough_slots: u32,
    /// The highest rate: rollouts per second with `enough_slots` or more.
    pub most_per_sec: f64,
}

impl Spent {
    /// Returns the time that occupies a core: processor time and `taken_secs`.
    fn busy(&self) -> f64 {
        self.physics_secs + self.drawing_secs + self.taken_secs
    }

    /// Returns the duration of a rollout whose slot has a core of its own.
    fn alone(&self) -> f64 {
        self.busy() + self.policy_secs
    }
}

/// Returns the rate of rollouts with the times `spent` on `machines`, if the policy's server
/// answers at most `policy_rate` queries per second. `None` if there is no machine or the rollouts
/// take no processor time, which means that nothing was measured.
pub(super) fn rate(machines: &[Machine], spent: &Spent, policy_rate: Option<f64>) -> Option<Rate> {
    let (busy, alone) = (spent.busy(), spent.alone());
    if busy <= 0.0 || !alone.is_finite() || machines.is_empty() {
        return None;
    }
    let by_cores = |machine: &Machine| f64::from(machine.cores) / busy;
    let by_slots = |machine: &Machine| f64::from(machine.slots) / alone;
    let simulated: f64 =
        machines.iter().map(|machine| by_slots(machine).min(by_cores(machine))).sum();
    let full: f64 = machines.iter().map(by_cores).sum();
    let answered = policy_rate.filter(|_| spent.queries > 0.0);
    let answered = answered.map_or(f64::INFINITY, |rate| rate / spent.queries);
    let bottleneck = match () {
        () if answered <= simulated => Bottleneck::Policy,
        () if simulated < full => Bottleneck::Slots,
        () => Bottleneck::Cores,
    };
    // Slots in use at a rate; the factor keeps a rounding error from adding a slot.
    let slots_in_use = |per_sec: f64| (per_sec * alone * (1.0 - 1e-12)).ceil();
    let slots_to_fill = |machine: &Machine| slots_in_use(by_cores(machine));
    let enough = match answered < full {
        true => slots_in_use(answered),
        false => machines.iter().map(slots_to_fill).sum(),
    };
    Some(Rate {
        per_sec: simulated.min(answered),
        bottleneck,
        // A float cast saturates.
        enough_slots: enough.max(1.0) as u32,
        most_per_sec: full.min(answered),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A rollout with four seconds on a core, and six seconds of the policy in thirty queries.
    const ROLLOUT: Spent = Spent {
        physics_secs: 3.0,
        drawing_secs: 1.0,
        policy_secs: 6.0,
        waiting_secs: 0.0,
        taken_secs: 0.0,
        queries: 30.0,
    };

    fn machine(slots: u32, cores: u32) -> Machine {
        Machine { slots, cores }
    }

    fn rate_of_example(machines: &[Machine], policy_rate: Option<f64>) -> Rate {
        rate(machines, &ROLLOUT, policy_rate).expect("a rate")
    }

    #[test]
    fn few_slots_wait_for_the_policy_while_cores_are_idle() {
        let few = rate_of_example(&[machine(4, 4)], None);
        assert_eq!((few.per_sec, few.bottleneck), (0.4, Bottleneck::Slots));
        assert_eq!((few.enough_slots, few.most_per_sec), (10, 1.0));
        let enough = rate_of_example(&[machine(10, 4)], None);
        assert_eq!((enough.per_sec, enough.bottleneck), (1.0, Bottleneck::Cores));
        assert_eq!(rate_of_example(&[machine(64, 4)], None).per_sec, 1.0);
    }

    #[test]
    fn slots_of_one_machine_do_not_use_the_cores_of_another() {
        let one_sided = rate_of_example(&[machine(40, 4), machine(2, 4)], None);
        assert_eq!(one_sided.per_sec, 1.0 + 0.2);
        assert_eq!(one_sided.bottleneck, Bottleneck::Slots);
        assert_eq!((one_sided.enough_slots, one_sided.most_per_sec), (20, 2.0));
    }

    #[test]
    fn a_slow_policy_bounds_the_rate_of_all_slots() {
        let bound = rate_of_example(&[machine(10, 4)], Some(15.0));
        assert_eq!((bound.per_sec, bound.bottleneck), (0.5, Bottleneck::Policy));
        assert_eq!((bound.enough_slots, bound.most_per_sec), (5, 0.5));
        let fast = rate_of_example(&[machine(4, 4)], Some(15.0));
        assert_eq!((fast.bottleneck, fast.enough_slots), (Bottleneck::Slots, 5));
    }

    #[test]
    fn without_a_measurement_or_a_machine_there_is_no_rate() {
        assert_eq!(rate(&[], &ROLLOUT, None), None);
        assert_eq!(rate(&[machine(1, 1)], &Spent::default(), None), None);
    }

    fn machines() -> impl Strategy<Value = Vec<Machine>> {
        let machine = (1..200_u32, 1..128_u32).prop_map(|(slots, cores)| machine(slots, cores));
        prop::collection::vec(machine, 1..6)
    }

    fn spent() -> impl Strategy<Value = Spent> {
        let secs = || 0.0..50.0_f64;
        let all = (0.01..50.0_f64, secs(), secs(), secs(), 0.0..300.0_f64);
        all.prop_map(|(physics_secs, drawing_secs, policy_secs, taken_secs, queries)| Spent {
            physics_secs,
            drawing_secs,
            policy_secs,
            waiting_secs: taken_secs,
            taken_secs,
            queries,
        })
    }

    fn policy() -> impl Strategy<Value = Option<f64>> {
        prop::option::of(0.1..1_000.0_f64)
    }

    proptest! {
        #[test]
        fn the_rate_equals_its_smallest_bound(
            machines in machines(), spent in spent(), policy in policy(),
        ) {
            let found = rate(&machines, &spent, policy).expect("a rate");
            let is_close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.max(1e-9);
            let slots: u32 = machines.iter().map(|machine| machine.slots).sum();
            let cores: u32 = machines.iter().map(|machine| machine.cores).sum();
            let by_slots = f64::from(slots) / spent.alone();
            let by_cores = f64::from(cores) / spent.busy();
            let queries_per_sec = found.per_sec * spent.queries;
            prop_assert!(found.per_sec <= by_slots * (1.0 + 1e-9));
            prop_assert!(found.per_sec <= by_cores * (1.0 + 1e-9));
            prop_assert!(policy.is_none_or(|rate| queries_per_sec <= rate * (1.0 + 1e-9)));
            prop_assert!(found.per_sec <= found.most_per_sec * (1.0 + 1e-9));
            match found.bottleneck {
                Bottleneck::Policy => {
                    prop_assert!(is_close(queries_per_sec, policy.expect("a rate")));
                }
                Bottleneck::Cores => prop_assert!(is_close(found.per_sec, by_cores)),
                Bottleneck::Slots => prop_assert!(found.per_sec < found.most_per_sec),
            }
        }

        #[test]
        fn more_slots_cores_or_machines_never_lower_the_rate(
            machines in machines(), spent in spent(), policy in policy(), index in 0..6_usize,
        ) {
            let before = rate(&machines, &spent, policy).expect("a rate").per_sec;
            let mut more = machines.clone();
            let place = index % more.len();
            more[place].slots += 1;
            let slots = rate(&more, &spent, policy).expect("a rate").per_sec;
            more[place].cores += 1;
            let cores = rate(&more, &spent, policy).expect("a rate").per_sec;
            more.push(machine(1, 1));
            let machine = rate(&more, &spent, policy).expect("a rate").per_sec;
            let faster = policy.map(|rate| rate * 2.0);
            let policy = rate(&more, &spent, faster).expect("a rate").per_sec;
            let all = [before, slots, cores, machine, policy];
            prop_assert!(all.is_sorted_by(|a, b| *a <= b * (1.0 + 1e-9)), "{all:?}");
        }

        #[test]
        fn the_highest_rate_needs_at_least_enough_slots(
            cores in 1..128_u32, spent in spent(), policy in policy(),
        ) {
            let found = rate(&[machine(1, cores)], &spent, policy).expect("a rate");
            let with = |slots| rate(&[machine(slots, cores)], &spent, policy).expect("a rate");
            let enough = with(found.enough_slots);
            prop_assert!(enough.per_sec >= found.most_per_sec * (1.0 - 1e-9));
            if found.enough_slots > 1 {
                let fewer = with(found.enough_slots - 1).per_sec;
                prop_assert!(fewer < found.most_per_sec * (1.0 + 1e-12));
            }
        }

        #[test]
        fn the_order_of_machines_changes_nothing(
            machines in machines(), spent in spent(), policy in policy(),
        ) {
            let mut reversed = machines.clone();
            reversed.reverse();
            let (a, b) = (rate(&machines, &spent, policy), rate(&reversed, &spent, policy));
            let (a, b) = (a.expect("a rate"), b.expect("a rate"));
            prop_assert!((a.per_sec - b.per_sec).abs() <= 1e-9 * a.per_sec);
            prop_assert_eq!(a.enough_slots, b.enough_slots);
        }
    }
}
