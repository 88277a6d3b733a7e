//! Adam with decoupled decay, a clipped gradient, and a running mean of the parameters.
use lipstream::kinds::recurrent::parameters::{GROUPS, Group, Parameters};

/// How a step is taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// Learning rate at its highest.
    pub rate: f32,
    /// Steps until the rate is highest; afterwards it falls as a cosine to 0 at `steps`.
    pub warm_up: usize,
    /// Steps of the whole run.
    pub steps: usize,
    /// The gradient's length is cut to this.
    pub clip: f32,
    /// Part of the way to their rest that parameters go in a step at the highest rate.
    pub decay: f32,
    /// Weight of the past in the running mean of the parameters.
    pub average: f32,
    /// Multiplies the rate of the transitions and of the first phone; 0 leaves them as likelihood training made them.
    pub transition_rate: f32,
    /// The groups that learn; all where `None`.
    pub only: Option<&'static [Group]>,
}

impl Default for Rule {
    fn default() -> Self {
        Self {
            rate: 0.006,
            warm_up: 60,
            steps: 0,
            clip: 0.5,
            decay: 0.003,
            average: 0.98,
            transition_rate: 0.0,
            only: None,
        }
    }
}

impl Rule {
    /// This rule over a run of so many steps, of which at most a quarter are warm-up.
    pub(super) fn over(&self, steps: usize) -> Self {
        Self {
            steps,
            warm_up: self.warm_up.min(steps / 4),
            ..self.clone()
        }
    }

    /// Share of the highest rate at `step`.
    pub fn schedule(&self, step: usize) -> f32 {
        if step < self.warm_up {
            return (step + 1) as f32 / self.warm_up as f32;
        }
        let rest = self.steps.saturating_sub(self.warm_up).max(1);
        let place = (step - self.warm_up) as f32 / rest as f32;
        0.5 * (1.0 + (std::f32::consts::PI * place.min(1.0)).cos())
    }
}

/// Neighbours among the numbers that learn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// How many they are.
    pub len: usize,
    /// Multiplies the learning rate; `None`: they stay as they are.
    pub rate: Option<f32>,
    /// What decay pulls them to; `None`: nothing does.
    pub rest: Option<f32>,
}

/// Numbers that a gradient moves.
pub trait Learnt: Clone {
    /// All of them.
    fn values(&self) -> &[f32];
    /// All of them, to be changed.
    fn values_mut(&mut self) -> &mut Vec<f32>;
    /// How they learn, in their order.
    fn spans(&self, rule: &Rule) -> Vec<Span>;
}

impl Learnt for Parameters {
    fn values(&self) -> &[f32] {
        &self.values
    }

    fn values_mut(&mut self) -> &mut Vec<f32> {
        &mut self.values
    }

    fn spans(&self, rule: &Rule) -> Vec<Span> {
        let span = |group: Group| {
            let learns = rule.only.is_none_or(|only| only.contains(&group));
            let own = match group {
                Group::Transition | Group::Initial => rule.transition_rate,
                _ => group.rate(),
            };
            Span {
                len: self.of(group).len(),
                rate: learns.then_some(own),
                rest: group.rest(&self.shape),
            }
        };
        GROUPS.into_iter().map(span).collect()
    }
}

/// Everything that a step changes.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimiser<P = Parameters> {
    /// The parameters as the last step left them.
    pub parameters: P,
    /// Running mean of the gradient, one number a parameter.
    pub first: Vec<f32>,
    /// Running mean of the squared gradient, one number a parameter.
    pub second: Vec<f32>,
    /// Running mean of the parameters.
    pub mean: P,
    /// Steps taken so far.
    pub step: usize,
}

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.99;
const SMALL: f32 = 1e-8;

impl<P: Learnt> Optimiser<P> {
    /// Before the first step: no gradient seen, the running mean at `parameters` themselves.
    pub fn new(parameters: P) -> Self {
        let n = parameters.values().len();
        Self {
            mean: parameters.clone(),
            parameters,
            first: vec![0.0; n],
            second: vec![0.0; n],
            step: 0,
        }
    }

    /// One step against `gradient`; returns the gradient's length before it was cut, or `None` if it is not finite.
    pub fn step(&mut self, rule: &Rule, gradient: &P) -> Option<f32> {
        let spans = self.parameters.spans(rule);
        let mut rest = gradient.values();
        let mut square = 0f64;
        for span in &spans {
            let (of_span, behind) = rest.split_at(span.len);
            if span.rate.is_some() {
                square = of_span.iter().fold(square, |sum, g| sum + f64::from(*g).powi(2));
            }
            rest = behind;
        }
        let length = square.sqrt() as f32;
        if !length.is_finite() {
            return None;
        }
        let cut = if length > rule.clip {
            rule.clip / length
        } else {
            1.0
        };
        let share = rule.schedule(self.step);
        self.step += 1;
        let corrected_1 = 1.0 - BETA_1.powi(self.step as i32);
        let corrected_2 = 1.0 - BETA_2.powi(self.step as i32);
        // Early on the mean forgets faster, so that it is not the start.
        let keep = rule.average.min(self.step as f32 / (self.step as f32 + 10.0));
        let values = self.parameters.values_mut();
        let means = self.mean.values_mut();
        let mut at = 0;
        for span in &spans {
            let places = at..at + span.len;
            at += span.len;
            let Some(own) = span.rate else { continue };
            let pull = span.rest.map(|rest| (rest, rule.decay * share));
            let rate = rule.rate * share * own;
            for i in places {
                let g = gradient.values()[i] * cut;
                self.first[i] = BETA_1 * self.first[i] + (1.0 - BETA_1) * g;
                self.second[i] = BETA_2 * self.second[i] + (1.0 - BETA_2) * g * g;
                let (m, v) = (self.first[i] / corrected_1, self.second[i] / corrected_2);
                let value = &mut values[i];
                *value -= rate * m / (v.sqrt() + SMALL);
                if let Some((rest, pull)) = pull {
                    *value -= pull * (*value - rest);
                }
                means[i] = keep * means[i] + (1.0 - keep) * *value;
            }
        }
        Some(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::kinds::recurrent::context::Context;
    use lipstream::kinds::recurrent::parameters::{Feedback, Gate, Shape};

    fn tiny() -> Parameters {
        Parameters::zeros(&Shape {
            phones: 2,
            context: Context::default(),
            inputs: 2,
            memory: 3,
            outputs: 2,
            feedback: Feedback::Output,
            maps: Gate::Both,
            rates: Gate::Audio,
        })
    }

    #[test]
    fn a_bowl_is_walked_down() {
        let mut optimiser = Optimiser::new(tiny());
        optimiser.parameters.values.fill(0.7);
        let rule = Rule {
            steps: 600,
            decay: 0.0,
            transition_rate: 1.0,
            ..Rule::default()
        };
        for _ in 0..600 {
            let mut gradient = optimiser.parameters.clone();
            // Minimum at 0.5 everywhere.
            gradient.values.iter_mut().for_each(|v| *v -= 0.5);
            optimiser.step(&rule, &gradient).unwrap();
        }
        for group in GROUPS {
            for v in optimiser.mean.of(group) {
                assert!((v - 0.5).abs() < 0.05, "{} {v}", group.name());
            }
        }
    }

    #[test]
    fn a_gradient_that_is_no_number_is_refused() {
        let mut optimiser = Optimiser::new(tiny());
        let mut gradient = tiny();
        gradient.values[3] = f32::NAN;
        let before = optimiser.parameters.clone();
        assert_eq!(optimiser.step(&Rule::default(), &gradient), None);
        assert_eq!(optimiser.parameters, before);
    }

    #[test]
    fn the_rate_rises_and_falls() {
        let rule = Rule {
            steps: 200,
            ..Rule::default()
        };
        assert!(rule.schedule(0) < 0.02);
        assert!((rule.schedule(60) - 1.0).abs() < 1e-6);
        assert!(rule.schedule(200) < 1e-6);
    }
}
