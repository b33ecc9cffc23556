//! One joint from data to a tuned, certified and examined result, by either design.

use super::certificate::{SaturatedCertificate, SaturatedMargins};
use super::evidence::{Evidence, gather};
use super::gains_file::JointGains;
use super::lmi::SolveError;
use super::margins::{LinearFigures, linear_figures};
use super::paper::{PaperCertificate, PaperMargins, System, largest_decay};
use super::problem::{JointInput, Problem, ProblemError};
use super::saturated::{self, Gains, SaturatedError};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Design {
    /// Theorem 1 of the paper: continuous time, never saturates.
    Paper,
    /// Discrete time, delay and drive lag as states, saturation certified.
    Saturated,
}

/// Proof of a result.
#[derive(Clone, Debug, PartialEq)]
pub enum Proof {
    /// Of the paper's design; the sampled loop with its delay is outside its model.
    Paper(PaperCertificate, PaperMargins),
    /// Of the saturated design.
    Saturated(SaturatedCertificate, SaturatedMargins),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    pub input: JointInput,
    /// The same, checked.
    pub problem: Problem,
    /// [k_pos, k_vel, k_last].
    pub gains: Gains,
    /// Why it holds.
    pub proof: Proof,
    /// Unsaturated figures of the sampled loop with delay and lag.
    pub figures: LinearFigures,
    /// Dense sampling of the saturated loop; `None` for the paper's design, whose claim does not cover it.
    pub evidence: Option<Evidence>,
}

/// Why a joint could not be tuned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// The data.
    #[error(transparent)]
    Problem(#[from] ProblemError),
    /// No saturated design.
    #[error(transparent)]
    Saturated(#[from] SaturatedError),
    /// The solver found no gains for Theorem 1.
    #[error("joint {joint}: Theorem 1: {cause}")]
    Paper {
        joint: usize,
        /// From the solver.
        cause: SolveError,
    },
    /// The paper's design ignores sampling and delay, and here they matter.
    #[error(
        "joint {joint}: the gains of Theorem 1 are unstable at a period of {period_s} s with {delay_s} s of delay \
         (largest eigenvalue {radius:.3}); shorten the period or use --design saturated"
    )]
    UnstableWhenSampled {
        joint: usize,
        /// Nominal period.
        period_s: f64,
        /// Nominal delay.
        delay_s: f64,
        /// Spectral radius.
        radius: f64,
    },
    /// A finished design fails its own check: a defect of this program.
    #[error("joint {joint}: a finished design fails its check ({what}); please report this")]
    Refused {
        joint: usize,
        /// What fails.
        what: String,
    },
}

/// Boundary states sampled for the evidence.
const EVIDENCE_STATES: usize = 2000;

/// Designs, certifies, checks and examines one joint.
///
/// # Errors
/// [`DesignError`] with the limiting condition and the next step.
pub fn tune(input: &JointInput, design: Design) -> Result<Tuned, DesignError> {
    let problem = Problem::new(input)?;
    let joint = input.joint;
    let (gains, proof) = match design {
        Design::Saturated => {
            let certificate = saturated::design(&problem)?;
            let margins = certificate
                .check(&problem)
                .map_err(|e| DesignError::Refused { joint, what: e.to_string() })?;
            (certificate.gains, Proof::Saturated(certificate, margins))
        }
        Design::Paper => {
            let system = System::of(&problem);
            let certificate = largest_decay(&system).map_err(|cause| DesignError::Paper { joint, cause })?;
            let margins = certificate
                .check(&system)
                .map_err(|e| DesignError::Refused { joint, what: e.to_string() })?;
            let gains = certificate
                .gains(&problem)
                .ok_or_else(|| DesignError::Refused { joint, what: "Q is singular".into() })?;
            (gains, Proof::Paper(certificate, margins))
        }
    };
    let figures = linear_figures(&problem, gains);
    if figures.spectral_radius >= 1.0 {
        let (period_s, delay_s) = problem.grid(1)[0];
        let radius = figures.spectral_radius;
        return Err(DesignError::UnstableWhenSampled { joint, period_s, delay_s, radius });
    }
    let evidence = match &proof {
        Proof::Saturated(certificate, _) => gather(&problem, certificate, EVIDENCE_STATES, 1),
        Proof::Paper(..) => None,
    };
    Ok(Tuned { input: input.clone(), problem, gains, proof, figures, evidence })
}

impl Tuned {
    pub fn entry(&self) -> JointGains {
        match &self.proof {
            Proof::Saturated(c, _) => JointGains::saturated(&self.input, c),
            Proof::Paper(c, _) => JointGains::paper(&self.input, self.gains, c),
        }
    }

    /// Guaranteed decay, 1/s: of the saturated loop over the region, or Theorem 1's.
    pub fn decay_1_s(&self) -> f64 {
        match &self.proof {
            Proof::Saturated(c, _) => c.regions.iter().map(|r| r.decay_1_s).fold(f64::INFINITY, f64::min),
            Proof::Paper(c, _) => c.alpha,
        }
    }

    /// Smallest proven eigenvalue margin.
    pub fn margin(&self) -> f64 {
        match &self.proof {
            Proof::Saturated(_, m) => m.decay.min(m.input).min(m.initial_set),
            Proof::Paper(_, m) => m.decay.min(m.input).min(m.unit_ball),
        }
    }
}
