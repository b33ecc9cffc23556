//! Which marker is the ball, and when its flight began.
//!
//! A ball in flight is a chain of markers, one per frame, that fit one flight. Without a flight, chains are
//! searched backwards from the newest frame. With a flight, the marker nearest to the prediction continues it if it
//! is inside the gate. Samples that contradict the batch are removed: the worst one, or the oldest, which may still
//! be from the hand.

use nalgebra::Vector3;
use planner::catch::forecast::{Forecast, Foreseen, Watch};

use super::fit::{Air, Flight, FlightPrior, Sample};
use super::stream::MarkerFrame;

/// Chi-square of three degrees of freedom that 1 in 1000 exceeds.
const GATE: f64 = 16.3;
/// Chi-square of six degrees of freedom (place and velocity) that 1 in 1000 exceeds.
const PRIOR_GATE: f64 = 22.46;
/// Normal quantile of the same level.
const GATE_SIGMAS: f64 = 3.09;
/// Balls begin between these speeds, m/s.
const SPEED_M_S: (f64, f64) = (1.0, 12.0);
/// After this many frames without a marker inside the gate a flight is searched again: the markers so far may have been the
/// hand.
const MISSES_MAX: usize = 3;
/// Frames that are kept while there is no flight, and samples at most in a batch.
const FRAMES_MAX: usize = 24;
const SAMPLES_MAX: usize = 160;
/// After this many frames after the planned release without the ball, it was not released.
const UNSEEN_MIN: usize = 24;
/// A flight that was not seen for this long is over, s.
const LOST_AFTER_S: f64 = 1.0;
/// Times of a forecast.
const GRID_STEP_S: f64 = 0.005;
const GRID: usize = 220;

/// What is known of tracker and ball.
#[derive(Debug, Clone, PartialEq)]
pub struct WatchOptions {
    /// Standard deviation of a marker per axis, m.
    pub sigma_m: f64,
    /// Time between two frames, s.
    pub period_s: f64,
    /// Gravity and drag.
    pub air: Air,
    /// Samples before the first forecast without a prior.
    pub first_samples: usize,
    /// The plan of the thrower, if it is known.
    pub prior: Option<FlightPrior>,
}

#[derive(Debug, Clone)]
pub struct BallWatch {
    options: WatchOptions,
    frames: Vec<MarkerFrame>,
    samples: Vec<Sample>,
    flight: Option<Flight>,
    misses: usize,
    age_s: f64,
    /// Frames after the planned release before the ball was seen first; `None` once it was.
    unseen: Option<usize>,
    /// Markers and frames that were seen and not used.
    pub left_out: usize,
}

impl BallWatch {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(options: WatchOptions) -> Self {
        let age_s = 0.015;
        let (frames, samples) = (Vec::new(), Vec::new());
        Self { options, frames, samples, flight: None, misses: 0, age_s, unseen: Some(0), left_out: 0 }
    }

    /// Takes a frame; true if the flight has changed.
    pub fn observe(&mut self, frame: &MarkerFrame) -> bool {
        self.age_s = frame.age_s;
        if let Some(last) = self.samples.last()
            && frame.t_s > last.t_s + LOST_AFTER_S
        {
            self.samples.clear();
            self.flight = None;
        }
        let release_s = self.options.prior.as_ref().map_or(f64::INFINITY, |prior| prior.t_s);
        self.unseen = self.unseen.map(|frames| frames + usize::from(frame.t_s > release_s));
        if frame.markers.is_empty() {
            return false;
        }
        self.remember(frame);
        let mut changed = !self.samples.is_empty() && self.go_on(frame);
        self.misses = if changed { 0 } else { self.misses + 1 };
        // What contradicts a plan that few samples back may be a ball that does not follow it.
        let by_plan = self.options.prior.is_some() && self.samples.len() < self.options.first_samples;
        if !changed && (self.samples.is_empty() || self.misses >= MISSES_MAX || by_plan) {
            changed = self.begin(frame);
        }
        if changed {
            self.unseen = None;
            self.settle();
        }
        changed && self.flight.is_some()
    }

    fn remember(&mut self, frame: &MarkerFrame) {
        let place = self.frames.partition_point(|other| other.t_s < frame.t_s);
        self.frames.insert(place, frame.clone());
        if self.frames.len() > FRAMES_MAX {
            self.frames.remove(0);
        }
    }

    /// Searches a ball in flight, or one near the planned flight.
    fn begin(&mut self, frame: &MarkerFrame) -> bool {
        let release_s = self.options.prior.as_ref().map(|prior| prior.t_s);
        if let Some(chain) = self.newest_chain()
            && release_s.is_none_or(|release_s| chain[0].t_s > release_s)
        {
            self.samples = chain;
            return true;
        }
        let Some(prior) = &self.options.prior else { return false };
        if let Some(sample) = self.nearest(&Flight::of_prior(prior, &self.options.air), frame) {
            self.samples = vec![sample];
            return true;
        }
        self.left_out += frame.markers.len();
        false
    }

    /// The chain that ends in the newest frame and fits best.
    fn newest_chain(&self) -> Option<Vec<Sample>> {
        let mut best: Option<(f64, Vec<Sample>)> = None;
        let newest = self.frames.len() - 1;
        let needed = self.options.first_samples.max(4);
        for (_, last) in &self.frames[newest].markers {
            let Some(before) = newest.checked_sub(1) else { break };
            for (_, first) in &self.frames[before].markers {
                let Some(chain) = self.chain(newest, last, first, needed) else { continue };
                let fit = Flight::fit(&chain, self.options.sigma_m, &self.options.air, None);
                let Some((chi2, n)) = fit.map(|flight| flight.chi2) else { continue };
                if chi2 < quantile(3 * n - 6) && best.as_ref().is_none_or(|(other, _)| chi2 < *other) {
                    best = Some((chi2, chain));
                }
            }
        }
        best.map(|(_, chain)| chain)
    }

    /// Backwards from two markers: in each older frame the one nearest to the parabola through those found so far.
    fn chain(
        &self,
        newest: usize,
        last: &Vector3<f64>,
        first: &Vector3<f64>,
        needed: usize,
    ) -> Option<Vec<Sample>> {
        let sample = |frame: usize, p: &Vector3<f64>| Sample { t_s: self.frames[frame].t_s, p_m: *p };
        let mut chain = vec![sample(newest, last), sample(newest - 1, first)];
        let g = Vector3::new(0.0, 0.0, -self.options.air.gravity_m_s2);
        for frame in (0..newest - 1).rev() {
            if chain.len() == needed {
                break;
            }
            let (a, z) = (chain[chain.len() - 1], chain[0]);
            let span = z.t_s - a.t_s;
            // Velocity at the older end of the chain so far.
            let v = (z.p_m - a.p_m) / span - g * (0.5 * span);
            if v.norm() > SPEED_M_S.1 {
                return None;
            }
            let back = self.frames[frame].t_s - a.t_s;
            let expected = a.p_m + v * back + g * (0.5 * back * back);
            // Two markers with noise, extrapolated over `back`.
            let room = 4.0 * self.options.sigma_m * (1.0 + 2.0 * (back / span).abs());
            let near = self.frames[frame].markers.iter().map(|(_, p)| p);
            let near = near.min_by(|p, q| (*p - expected).norm().total_cmp(&(*q - expected).norm()))?;
            if (near - expected).norm() > room * 3.0_f64.sqrt() {
                return None;
            }
            chain.push(sample(frame, near));
        }
        chain.reverse();
        let way = chain[chain.len() - 1].p_m - chain[0].p_m;
        let fast = way.norm() >= SPEED_M_S.0 * (chain[chain.len() - 1].t_s - chain[0].t_s);
        (chain.len() == needed && fast).then_some(chain)
    }

    /// Continues the flight with the marker that fits best.
    fn go_on(&mut self, frame: &MarkerFrame) -> bool {
        let Some(flight) = &self.flight else { return false };
        let Some(sample) = self.nearest(flight, frame) else {
            self.left_out += frame.markers.len();
            return false;
        };
        self.left_out += frame.markers.len() - 1;
        let place = self.samples.partition_point(|other| other.t_s < sample.t_s);
        self.samples.insert(place, sample);
        if self.samples.len() > SAMPLES_MAX {
            self.samples.remove(0);
        }
        true
    }

    /// The marker inside the gate that is nearest to the flight.
    fn nearest(&self, flight: &Flight, frame: &MarkerFrame) -> Option<Sample> {
        let (p, _, covariance) = flight.at(frame.t_s);
        let mut spread = covariance;
        for axis in 0..3 {
            spread[(axis, axis)] += self.options.sigma_m * self.options.sigma_m;
        }
        let inverse = spread.try_inverse()?;
        let off = |q: &Vector3<f64>| (q - p).dot(&(inverse * (q - p)));
        let near = frame.markers.iter().map(|(_, q)| (off(q), q));
        let (off, near) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (off < GATE).then_some(Sample { t_s: frame.t_s, p_m: *near })
    }

    /// A plan that the samples contradict is dropped: the fit with it is worse than the fit without it by more than
    /// chance explains.
    fn test_prior(&mut self) {
        let WatchOptions { sigma_m, air, first_samples, .. } = &self.options;
        let n = self.samples.len();
        if self.options.prior.is_none() || n < *first_samples {
            return;
        }
        let fit = |prior| Flight::fit(&self.samples, *sigma_m, air, prior);
        let Some(alone) = fit(None) else { return };
        let with = fit(self.options.prior.as_ref()).map_or(f64::INFINITY, |with| with.chi2_with_belief);
        if alone.chi2.0 < quantile(3 * n - 6) && with - alone.chi2_with_belief > PRIOR_GATE {
            self.options.prior = None;
        }
    }

    /// Fits; what the batch contradicts goes.
    fn settle(&mut self) {
        self.test_prior();
        let prior = self.options.prior.clone();
        loop {
            let fit = Flight::fit(&self.samples, self.options.sigma_m, &self.options.air, prior.as_ref());
            let Some(flight) = fit else {
                self.flight = None;
                self.samples.clear();
                return;
            };
            let (chi2, n) = flight.chi2;
            // Only a batch with more data than unknowns can contradict itself.
            let free = if prior.is_some() { 0 } else { 6 };
            if n < 5 || chi2 < quantile(3 * n - free) {
                self.flight = Some(flight);
                return;
            }
            let off = |s: &Sample| (s.p_m - flight.at(s.t_s).0).norm_squared();
            let worst = (0..n).max_by(|a, b| off(&self.samples[*a]).total_cmp(&off(&self.samples[*b])));
            let mut others = self.samples.clone();
            others.remove(worst.unwrap_or(0));
            let alone = Flight::fit(&others, self.options.sigma_m, &self.options.air, prior.as_ref());
            self.left_out += 1;
            // One false marker: without it the rest agrees. Else the oldest is from before the release.
            if alone.is_some_and(|fit| fit.chi2.0 < quantile(3 * (n - 1) - free)) {
                self.samples = others;
            } else {
                self.samples.remove(0);
            }
        }
    }

    /// The flight, if one is seen or known from the plan.
    #[must_use]
    pub fn flight(&self) -> Option<Flight> {
        let planned = || self.options.prior.as_ref().map(|prior| Flight::of_prior(prior, &self.options.air));
        self.flight.clone().or_else(planned)
    }

    /// The plan announced a ball, the tracker looked, and no ball flew.
    #[must_use]
    pub fn saw_no_release(&self) -> bool {
        self.unseen.is_some_and(|frames| frames >= UNSEEN_MIN)
    }

    /// Samples of the flight so far.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// The flight from `now_s` on, for about a second.
    #[must_use]
    pub fn forecast(&self, now_s: f64) -> Option<Forecast> {
        let flight = self.flight()?;
        let planned = self.options.prior.as_ref().map(|prior| prior.t_s);
        let first_s = self.samples.first().map(|s| s.t_s).or(planned).unwrap_or(now_s);
        // Before the release there is no flight.
        let from_s = planned.map_or(now_s, |release| release.max(now_s));
        let course = flight.course(from_s, GRID_STEP_S, GRID);
        let points = course.into_iter().enumerate().map(|(k, (p_m, v_m_s, covariance_m2))| Foreseen {
            t_s: from_s + GRID_STEP_S * k as f64,
            p_m,
            v_m_s,
            covariance_m2,
        });
        let watch = Watch {
            sigma_m: self.options.sigma_m,
            period_s: self.options.period_s,
            latency_s: self.age_s,
            first_s,
        };
        Some(Forecast { points: points.collect(), watch })
    }
}

/// Chi-square of `k` degrees of freedom that 1 in 1000 exceeds (Wilson and Hilferty).
fn quantile(k: usize) -> f64 {
    let k = k.max(1) as f64;
    let third = 2.0 / (9.0 * k);
    k * (1.0 - third + GATE_SIGMAS * third.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};
    use planner::plan::rng::SplitMix64;

    use super::*;

    const AIR: Air = Air { gravity_m_s2: 9.81, drag_1_m: 0.0, drag_sigma_1_m: 1e-4 };

    fn options() -> WatchOptions {
        WatchOptions { sigma_m: 0.002, period_s: 1.0 / 120.0, air: AIR, first_samples: 5, prior: None }
    }

    fn ball(t: f64) -> Vector3<f64> {
        Vector3::new(0.5 + 3.0 * t, 0.1, 0.4 + 2.5 * t - 4.905 * t * t)
    }

    fn frame(t_s: f64, markers: Vec<Vector3<f64>>) -> MarkerFrame {
        let markers = markers.into_iter().enumerate().map(|(id, p)| (id as u32, p)).collect();
        MarkerFrame { t_s, age_s: 0.015, markers }
    }

    fn noisy(rng: &mut SplitMix64, p: Vector3<f64>) -> Vector3<f64> {
        p + Vector3::from_fn(|_, _| 0.002 * rng.normal())
    }

    fn anywhere(rng: &mut SplitMix64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| 6.0 * rng.unit() - 3.0)
    }

    /// Errors stay as large as the covariance says: mean over 50 runs and three axes, 99.9 % band of a chi-square mean.
    #[test]
    fn the_ball_is_found_among_false_markers_and_followed() {
        let mut rng = SplitMix64::new(1);
        let (mut sum, runs) = (0.0, 50);
        for _ in 0..runs {
            let mut watch = BallWatch::new(options());
            for k in 1..=40 {
                let t = f64::from(k) / 120.0;
                let mut markers = vec![anywhere(&mut rng), anywhere(&mut rng)];
                markers.insert((rng.unit() * 3.0) as usize, noisy(&mut rng, ball(t)));
                watch.observe(&frame(t, markers));
            }
            let (p, _, covariance) = watch.flight().unwrap().at(0.6);
            let off = p - ball(0.6);
            sum += off.dot(&(covariance.try_inverse().unwrap() * off));
            assert!(watch.samples().len() >= 38, "{} of 40 samples", watch.samples().len());
        }
        let mean = sum / (3.0 * f64::from(runs));
        let band = 3.29 * (2.0 / (3.0 * f64::from(runs))).sqrt();
        assert!((mean - 1.0).abs() < band, "{mean} outside 1 ± {band}");
    }

    /// The hand carries the ball on an arc with 15 m/s² before the release: the part of it in the batch is too small to matter.
    #[test]
    fn samples_of_the_hand_are_shed() {
        let mut rng = SplitMix64::new(2);
        for _ in 0..50 {
            let mut watch = BallWatch::new(options());
            for k in -30..=30 {
                let t = f64::from(k) / 120.0;
                let v0 = Vector3::new(3.0, 0.0, 2.5);
                let hand = ball(0.0) + v0 * t + Vector3::new(-4.0, 2.0, 14.0) * (0.5 * t * t);
                let p = if k < 0 { hand } else { ball(t) };
                watch.observe(&frame(t, vec![noisy(&mut rng, p)]));
            }
            let first = watch.samples()[0].t_s;
            assert!(first > -0.035, "the batch begins at {first} s");
            let off = (watch.flight().unwrap().at(0.5).0 - ball(0.5)).norm();
            assert!(off < 0.03, "{off}");
        }
    }

    #[test]
    fn samples_count_by_their_stamp_whatever_order_they_come_in() {
        let times: Vec<f64> = (1..=20).map(|k| f64::from(k) / 120.0).collect();
        let mut watch = BallWatch::new(options());
        let mut swapped = BallWatch::new(options());
        for t in &times {
            watch.observe(&frame(*t, vec![ball(*t)]));
        }
        let mut order = times.clone();
        order.swap(12, 14);
        for t in &order {
            swapped.observe(&frame(*t, vec![ball(*t)]));
        }
        let apart = watch.flight().unwrap().at(0.6).0 - swapped.flight().unwrap().at(0.6).0;
        assert!(apart.norm() < 1e-6, "{apart}");
    }

    /// The plan is wrong by 60 mm and 0.3 m/s, or right: the ball is followed from the first samples on, and predicted as well
    /// as without a plan.
    #[test]
    fn a_plan_that_the_ball_does_not_follow_is_given_up_and_one_that_it_follows_helps() {
        let spread =
            |p: f64, v: f64| SMatrix::from_diagonal(&SVector::from([p, p, p, v, v, v]).map(|s| s * s));
        let mut sums = [[0.0; 2]; 2];
        for (which, (off_m, off_m_s)) in [(0.06, 0.3), (0.0, 0.0)].into_iter().enumerate() {
            let mut rng = SplitMix64::new(5);
            for _ in 0..60 {
                let off = Vector3::new(0.0, off_m, 0.0);
                let v_m_s = Vector3::new(3.0, 0.0, 2.5) + Vector3::new(0.0, 0.0, off_m_s);
                let prior =
                    FlightPrior { t_s: 0.0, p_m: ball(0.0) + off, v_m_s, covariance: spread(0.005, 0.05) };
                let mut watches = [
                    BallWatch::new(WatchOptions { prior: Some(prior), ..options() }),
                    BallWatch::new(options()),
                ];
                for k in 1..=8 {
                    let t = f64::from(k) / 120.0;
                    let seen = frame(t, vec![noisy(&mut rng, ball(t))]);
                    for watch in &mut watches {
                        watch.observe(&seen);
                    }
                }
                for (sum, watch) in sums[which].iter_mut().zip(&watches) {
                    *sum += (watch.flight().unwrap().at(0.6).0 - ball(0.6)).norm_squared();
                }
            }
        }
        let [wrong, right] = sums.map(|[with, without]| (with / without).sqrt());
        assert!((wrong - 1.0).abs() < 0.02, "{wrong}");
        assert!(right < 0.8, "{right}");
    }

    #[test]
    fn markers_that_stand_still_and_noise_alone_are_no_ball() {
        let mut rng = SplitMix64::new(3);
        let mut watch = BallWatch::new(options());
        for k in 0..200 {
            let markers = vec![noisy(&mut rng, Vector3::new(1.0, 0.0, 0.5)), anywhere(&mut rng)];
            watch.observe(&frame(f64::from(k) / 120.0, markers));
        }
        assert!(watch.flight().is_none());
        assert!(watch.forecast(2.0).is_none());
    }
}
