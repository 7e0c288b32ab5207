//! What a residual depends on: means in bins of a possible cause, with uncertainties that account for correlation in time.

use serde::Serialize;

/// Bins of a cause, given enough data.
const BINS: usize = 12;
/// Fewest blocks in a bin.
const PER_BIN: usize = 4;
/// Length of the blocks over which everything is averaged first, s: at least the correlation time of the residuals.
pub(crate) const BLOCK_S: f64 = 0.25;
/// Significance above which a residual is said to depend on a cause, standard deviations.
pub const SIGNIFICANT: f64 = 5.0;
/// Share of variance between bins above which a sentence is reported.
const WORTH: f64 = 0.15;

/// A residual by bins of a cause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Response {
    /// Name: `force`, `force_body_x`, `force_along_velocity`, `torque` …
    pub name: String,
    /// In words.
    pub title: String,
    /// Unit: N or N·m.
    pub unit: String,
    /// Mean in each bin.
    pub means: Vec<f64>,
    /// Standard error of each mean.
    pub standard_errors: Vec<f64>,
    /// Share of the variance (of means over 0.25 s) between bins, corrected for chance; 0 to 1.
    pub share: f64,
    /// Significance of that share, in standard deviations of a normal distribution.
    pub significance: f64,
    /// Correlation with the cause, −1 to 1.
    pub correlation: f64,
    /// Slope of the straight line against the cause, unit of the residual per unit of the cause.
    pub slope: f64,
    /// Standard deviation of the slope.
    pub slope_sigma: f64,
}

/// A possible cause and the residuals in bins of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cause {
    /// Name: `speed`, `height`, `rotor_speed`, `distance.NAME` …
    pub name: String,
    /// In words.
    pub title: String,
    /// SI unit.
    pub unit: String,
    /// Edges of the bins, one more than bins; bins hold about equally many samples.
    pub edges: Vec<f64>,
    /// Mean of the cause in each bin.
    pub values: Vec<f64>,
    /// Blocks of 0.25 s in each bin.
    pub counts: Vec<usize>,
    /// The residuals.
    pub responses: Vec<Response>,
}

/// Name, title and unit of a quantity.
pub(crate) type Label = (String, String, &'static str);

/// Means over blocks of [`BLOCK_S`]; NaN where unknown.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    /// Number of the block in its log; consecutive numbers have no gap between them.
    pub number: usize,
    pub causes: Vec<f64>,
    pub responses: Vec<f64>,
}

/// A cause against all responses; `None` where it hardly varies or there is too little data.
pub(crate) fn bins(blocks: &[Block], which: usize, label: &Label, responses: &[Label]) -> Option<Cause> {
    let mut order: Vec<usize> = (0..blocks.len()).filter(|i| blocks[*i].causes[which].is_finite()).collect();
    order.sort_by(|a, b| blocks[*a].causes[which].total_cmp(&blocks[*b].causes[which]));
    let n = order.len();
    let k = (n / PER_BIN).min(BINS);
    if k < 3 {
        return None;
    }
    let value = |i: usize| blocks[i].causes[which];
    let (low, high) = (value(order[0]), value(order[n - 1]));
    if !(high - low > 1e-6 * high.abs().max(low.abs()).max(1e-3)) {
        return None;
    }
    let mut bin_of = vec![usize::MAX; blocks.len()];
    let (mut edges, mut values, mut counts) = (vec![low], Vec::new(), Vec::new());
    for b in 0..k {
        let part = &order[b * n / k..(b + 1) * n / k];
        part.iter().for_each(|i| bin_of[*i] = b);
        let last = value(part[part.len() - 1]);
        let next = order.get((b + 1) * n / k).map_or(last, |i| value(*i));
        edges.push(0.5 * (last + next));
        values.push(part.iter().map(|i| value(*i)).sum::<f64>() / part.len() as f64);
        counts.push(part.len());
    }
    let responses = responses
        .iter()
        .enumerate()
        .filter_map(|(r, label)| respond(blocks, which, &bin_of, k, r, label))
        .collect();
    let (name, title, unit) = label.clone();
    Some(Cause { name, title, unit: unit.into(), edges, values, counts, responses })
}

fn respond(
    blocks: &[Block],
    which: usize,
    bin_of: &[usize],
    k: usize,
    r: usize,
    label: &Label,
) -> Option<Response> {
    let used: Vec<usize> =
        (0..blocks.len()).filter(|i| bin_of[*i] < k && blocks[*i].responses[r].is_finite()).collect();
    let (mut sums, mut counts) = (vec![0.0; k], vec![0.0; k]);
    for i in &used {
        sums[bin_of[*i]] += blocks[*i].responses[r];
        counts[bin_of[*i]] += 1.0;
    }
    if counts.iter().any(|c| *c < 2.0) {
        return None;
    }
    let means: Vec<f64> = sums.iter().zip(&counts).map(|(s, c)| s / c).collect();
    let n = used.len() as f64;
    let total = sums.iter().sum::<f64>() / n;
    let left = |i: usize| blocks[i].responses[r] - means[bin_of[i]];
    let within: f64 = used.iter().map(|i| left(*i).powi(2)).sum();
    let all: f64 = used.iter().map(|i| (blocks[*i].responses[r] - total).powi(2)).sum();
    if !(all > 0.0) || !(n > k as f64 + 1.0) {
        return None;
    }
    // Residuals about the bin means are correlated from block to block; with correlation ρ the effective number of blocks
    // is n (1 − ρ)/(1 + ρ): Bartlett, "Some aspects of the time-correlation problem in regard to tests of significance",
    // Journal of the Royal Statistical Society 98(3), 1935.
    let (mut lagged, mut pairs) = (0.0, 0.0);
    for w in used.windows(2) {
        if blocks[w[1]].number == blocks[w[0]].number + 1 {
            lagged += left(w[0]) * left(w[1]);
            pairs += 1.0;
        }
    }
    let rho =
        if pairs > 8.0 && within > 0.0 { (lagged / pairs / (within / n)).clamp(0.0, 0.95) } else { 0.0 };
    let worth = (1.0 - rho) / (1.0 + rho);
    let (df1, df2) = (k as f64 - 1.0, ((n - k as f64) * worth).max(2.0));
    let spread = within / (n - k as f64);
    let share = (1.0 - spread / (all / (n - 1.0))).clamp(0.0, 1.0);
    let f = if spread > 0.0 { (all - within) / df1 / spread * worth } else { f64::MAX };
    let standard_errors = counts.iter().map(|c| (spread / (c * worth)).sqrt()).collect();

    let x = |i: usize| blocks[i].causes[which];
    let middle = used.iter().map(|i| x(*i)).sum::<f64>() / n;
    let (mut xx, mut xy) = (0.0, 0.0);
    for i in &used {
        xx += (x(*i) - middle).powi(2);
        xy += (x(*i) - middle) * (blocks[*i].responses[r] - total);
    }
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    let rest = (all - slope * xy).max(0.0) / (n - 2.0);
    let slope_sigma = if xx > 0.0 { (rest / xx / worth).sqrt() } else { 0.0 };
    let (name, title, unit) = label.clone();
    Some(Response {
        name,
        title,
        unit: unit.into(),
        means,
        standard_errors,
        share,
        significance: normal_of_f(f.min(1e9), df1, df2),
        correlation: if xx > 0.0 { xy / (xx * all).sqrt() } else { 0.0 },
        slope,
        slope_sigma,
    })
}

/// Standard normal deviate with the same tail probability as F with (df1, df2) degrees of freedom.
///
/// Paulson, "An approximate normalization of the analysis of variance distribution", Annals of Mathematical Statistics
/// 13(2), 1942.
fn normal_of_f(f: f64, df1: f64, df2: f64) -> f64 {
    let (a, b) = (2.0 / (9.0 * df1), 2.0 / (9.0 * df2));
    let root = f.max(0.0).cbrt();
    ((1.0 - b) * root - (1.0 - a)) / (a + root * root * b).sqrt()
}

/// A number with three significant digits.
pub(crate) fn short(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    let digits = (2 - x.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{x:.digits$}")
}

/// What the residuals depend on, strongest first: (share of variance, sentence). One sentence per cause, about the residual
/// that depends most on it.
pub(crate) fn sentences(causes: &[Cause]) -> Vec<(f64, String)> {
    let mut out: Vec<(f64, String)> = Vec::new();
    for cause in causes {
        let telling = cause
            .responses
            .iter()
            .filter(|r| r.significance >= SIGNIFICANT && r.share >= WORTH)
            .max_by(|a, b| a.share.total_cmp(&b.share));
        let Some(r) = telling else { continue };
        let (first, last) = (0, cause.values.len() - 1);
        let verb = match () {
            () if r.correlation > 0.5 => "grows with",
            () if r.correlation < -0.5 => "falls with",
            () => "changes with",
        };
        let at = |b: usize| {
            format!("{} {} at {} {}", short(r.means[b]), r.unit, short(cause.values[b]), cause.unit)
        };
        let mut shown = vec![at(first)];
        if verb == "changes with" {
            shown.push(at(last / 2));
        }
        shown.push(at(last));
        let text = format!(
            "the residual {} {verb} {}: {} ({:.0} % of its variance, {:.0} standard deviations)",
            r.title,
            cause.title,
            shown.join(", "),
            100.0 * r.share,
            r.significance
        );
        out.push((r.share, text));
    }
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blocks(f: impl Fn(f64) -> f64, n: usize) -> Vec<Block> {
        let noise = |i: usize| {
            let x = (i as f64 * 12.9898).sin() * 43758.5453;
            x - x.floor() - 0.5
        };
        (0..n)
            .map(|i| {
                let x = 2.5 + 2.5 * (i as f64 * 0.37).sin();
                Block { number: i, causes: vec![x], responses: vec![f(x) + noise(i)] }
            })
            .collect()
    }

    fn of(blocks: &[Block]) -> Cause {
        let label = ("speed".into(), "speed".into(), "m/s");
        bins(blocks, 0, &label, &[("force".into(), "force".into(), "N")]).unwrap()
    }

    #[test]
    fn a_line_is_found_with_its_slope_and_its_share() {
        let cause = of(&blocks(|x| -0.4 * x, 400));
        let r = &cause.responses[0];
        assert!((r.slope + 0.4).abs() < 3.0 * r.slope_sigma && r.slope_sigma < 0.02, "{r:?}");
        // Variance of the line 0.16 · 3.125, of the noise 1/12.
        let share = 0.5 / (0.5 + 1.0 / 12.0);
        assert!((r.share - share).abs() < 0.05 && r.significance > 10.0, "{r:?}");
        assert!(cause.counts.iter().all(|c| *c == 33 || *c == 34) && cause.edges.len() == 13);
        let text = &sentences(&[cause])[0].1;
        assert!(text.contains("falls with speed"), "{text}");
    }

    #[test]
    fn noise_alone_is_not_significant() {
        for n in [60, 240, 1000] {
            let cause = of(&blocks(|_| 0.0, n));
            assert!(cause.responses[0].significance < 3.0, "{n}: {:?}", cause.responses[0]);
            assert!(sentences(&[cause]).is_empty());
        }
    }

    #[test]
    fn slow_drift_that_has_nothing_to_do_with_the_cause_is_no_proof() {
        // Long runs of equal values: effectively only a few samples.
        let mut list = blocks(|_| 0.0, 240);
        for (i, b) in list.iter_mut().enumerate() {
            b.responses[0] = ((i / 40) as f64 * 2.3).sin();
            b.causes[0] = (i as f64 * 0.05).sin();
        }
        let r = of(&list).responses[0].clone();
        assert!(r.significance < SIGNIFICANT, "{r:?}");
    }

    #[test]
    fn the_normal_deviate_of_f_is_that_of_tables() {
        // 5 % points of F: 1.645 standard deviations.
        for (f, a, b) in [(2.37, 5.0, 60.0), (3.00, 2.0, 1e6), (1.87, 11.0, 100.0)] {
            let z = normal_of_f(f, a, b);
            assert!((z - 1.645).abs() < 0.06, "{f} {a} {b}: {z}");
        }
    }

    #[test]
    fn a_cause_that_does_not_change_has_no_bins() {
        let mut list = blocks(|x| x, 100);
        list.iter_mut().for_each(|b| b.causes[0] = 1.5);
        assert_eq!(bins(&list, 0, &("h".into(), "h".into(), "m"), &[]), None);
    }
}
