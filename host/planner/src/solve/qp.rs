//! Small dense quadratic programs by the dual active-set method.
//!
//! `min ½ dᵀ H d + gᵀ d` subject to `aᵢ d + cᵢ = 0` (equalities) and `aᵢ d + cᵢ ≥ 0` (inequalities), H positive
//! definite. The dual method starts from the unconstrained minimum, so it needs no feasible point, adds one violated
//! row at a time and proves infeasibility when there is none. Source: WIDTH. Goldfarb, A. Idnani, "A numerically stable
//! dual method for solving strictly convex quadratic programs", Mathematical Programming 27, 1983.
//!
//! Fixed-size arrays on the stack: a program of the planner has some 24 variables, and it is solved some ten times
//! per local solve, so allocation would cost more than the arithmetic. Loops run to the number of variables, rounded up to
//! [`LANES`], not to the width of a row.

/// Width of a row: the most variables of a task. A throw of eight joints has 30.
pub const WIDTH: usize = 32;
/// A row of coefficients; entries beyond the number of variables are zero.
pub type Row = [f64; WIDTH];
/// A square matrix, row by row.
pub(crate) type Square = [Row; WIDTH];

/// One linear constraint `a d + c (= or ≥) 0`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Constraint {
    pub(crate) a: Row,
    pub(crate) c: f64,
}

/// Why there is no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum QpFailure {
    /// No point satisfies the constraints.
    Infeasible,
    /// H is not positive definite, or the iteration limit was hit.
    Numerical,
}

/// Minimiser, and multipliers in the order of the constraints.
#[derive(Debug, Clone)]
pub(crate) struct QpSolution {
    pub(crate) d: Row,
    pub(crate) eq: Vec<f64>,
    pub(crate) ineq: Vec<f64>,
}

/// Sums and rotations run over this many numbers at once, up to the next multiple beyond n.
const LANES: usize = 4;

#[inline]
fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// Scalar product of the first `m` entries, `m` a multiple of [`LANES`].
#[inline]
fn dot(a: &[f64], b: &[f64], m: usize) -> f64 {
    let mut sums = [0.0; LANES];
    for (x, y) in a[..m].chunks_exact(LANES).zip(b[..m].chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += x[lane] * y[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// `y += t x` on the first `m` entries.
#[inline]
fn add_scaled(y: &mut [f64], t: f64, x: &[f64], m: usize) {
    for (y, x) in y[..m].iter_mut().zip(&x[..m]) {
        *y += t * x;
    }
}

/// A positive definite matrix H, as the columns of `J = L⁻ᵀ` with `H = L Lᵀ`: what the dual method works with. On the heap: it is kept
/// from step to step, and to move 8 KB costs more than the allocation.
#[derive(Debug, Clone)]
pub(crate) struct Factor {
    columns: Box<[Row]>,
}

impl Factor {
    /// Of the unit matrix.
    pub(crate) fn identity() -> Self {
        let mut columns = vec![[0.0; WIDTH]; WIDTH].into_boxed_slice();
        for (k, column) in columns.iter_mut().enumerate() {
            column[k] = 1.0;
        }
        Self { columns }
    }

    /// Factorises the leading `n × n` block; `None` if it is not positive definite.
    pub(crate) fn new(h: &Square, n: usize) -> Option<Self> {
        let mut l = [[0.0; WIDTH]; WIDTH];
        for i in 0..n {
            let (above, rest) = l.split_at_mut(i);
            let row = &mut rest[0];
            for (k, other) in above.iter().enumerate() {
                // Entries of `other` beyond k are zero.
                row[k] = (h[i][k] - dot(row, other, padded(k))) / other[k];
            }
            let pivot = h[i][i] - dot(row, row, padded(i));
            // A pivot that lost all digits to cancellation is as good as a negative one.
            let sound = pivot > 1e-10 * h[i][i].abs().max(1e-8) && pivot.is_finite();
            if !sound {
                return None;
            }
            row[i] = pivot.sqrt();
        }
        // Column k of J is row k of L⁻¹.
        let mut columns = vec![[0.0; WIDTH]; WIDTH].into_boxed_slice();
        for k in 0..n {
            let (above, rest) = columns.split_at_mut(k);
            let column = &mut rest[0];
            for (other, factor) in above.iter().zip(&l[k]) {
                add_scaled(column, -factor, other, padded(k));
            }
            column[k] = 1.0;
            let scale = 1.0 / l[k][k];
            column.iter_mut().take(k + 1).for_each(|c| *c *= scale);
        }
        Some(Self { columns })
    }
}

struct ActiveSet {
    n: usize,
    m: usize,
    /// The minimum under the active constraints.
    x: Row,
    /// J = L⁻ᵀ Q, column by column.
    j: Square,
    /// Upper triangular R of the active normals, column by column.
    r: Square,
    count: usize,
    /// Active equalities: the first of all.
    fixed: usize,
    /// Constraint numbers and their multipliers.
    index: [usize; WIDTH],
    u: Row,
}

impl ActiveSet {
    /// Without constraints.
    fn new(factor: &Factor, g: &Row, n: usize) -> Self {
        let (zero, m) = ([0.0; WIDTH], padded(n));
        let mut set = Self {
            n,
            m,
            x: zero,
            j: [zero; WIDTH],
            r: [zero; WIDTH],
            count: 0,
            fixed: 0,
            index: [0; WIDTH],
            u: zero,
        };
        set.j[..n].copy_from_slice(&factor.columns[..n]);
        // x = -J Jᵀ g: no constraint is active yet, so all columns count.
        set.x = set.primal(&set.project(g)).map(|z| -z);
        set
    }

    /// `a x + c`.
    fn value(&self, constraint: &Constraint) -> f64 {
        dot(&constraint.a, &self.x, self.m) + constraint.c
    }

    /// `d = Jᵀ a`.
    fn project(&self, a: &Row) -> Row {
        let mut d = [0.0; WIDTH];
        for (dk, column) in d.iter_mut().zip(&self.j).take(self.n) {
            *dk = dot(column, a, self.m);
        }
        d
    }

    /// Step direction in primal space `z = J₂ d₂`.
    fn primal(&self, d: &Row) -> Row {
        let mut z = [0.0; WIDTH];
        for (column, dk) in self.j[self.count..self.n].iter().zip(&d[self.count..self.n]) {
            add_scaled(&mut z, *dk, column, self.m);
        }
        z
    }

    /// Step direction in dual space `R⁻¹ d₁`.
    fn dual(&self, d: &Row) -> Row {
        let mut r = [0.0; WIDTH];
        r[..self.count].copy_from_slice(&d[..self.count]);
        for i in (0..self.count).rev() {
            let column = &self.r[i];
            let v = r[i] / column[i];
            r[i] = v;
            for (rk, ck) in r[..i].iter_mut().zip(&column[..i]) {
                *rk -= v * ck;
            }
        }
        r
    }

    /// Turns columns k - 1 and k of J by the rotation (c, s).
    fn rotate(&mut self, k: usize, c: f64, s: f64) {
        let (left, right) = self.j.split_at_mut(k);
        let (a, b) = (&mut left[k - 1], &mut right[0]);
        for (p, q) in a[..self.m].iter_mut().zip(&mut b[..self.m]) {
            (*p, *q) = (c * *p + s * *q, c * *q - s * *p);
        }
    }

    /// Adds a constraint whose projection is `d`; false if its normal depends on the active ones.
    fn add(&mut self, mut d: Row, constraint: usize, u: f64) -> bool {
        // Givens rotations of the last entries of d into entry `count`.
        for k in (self.count + 1..self.n).rev() {
            let (a, b) = (d[k - 1], d[k]);
            if b == 0.0 {
                continue;
            }
            let h = (a * a + b * b).sqrt();
            d[k - 1] = h;
            d[k] = 0.0;
            self.rotate(k, a / h, b / h);
        }
        if d[self.count].abs() <= 1e-12 {
            return false;
        }
        self.r[self.count][..=self.count].copy_from_slice(&d[..=self.count]);
        self.index[self.count] = constraint;
        self.u[self.count] = u;
        self.count += 1;
        true
    }

    /// Drops active constraint number `position`.
    fn drop(&mut self, position: usize) {
        for k in position..self.count - 1 {
            self.index[k] = self.index[k + 1];
            self.u[k] = self.u[k + 1];
            self.r[k] = self.r[k + 1];
        }
        self.count -= 1;
        for k in position..self.count {
            let (a, b) = (self.r[k][k], self.r[k][k + 1]);
            if b == 0.0 {
                continue;
            }
            let h = (a * a + b * b).sqrt();
            let (c, s) = (a / h, b / h);
            for column in &mut self.r[k..self.count] {
                let (p, q) = (column[k], column[k + 1]);
                column[k] = c * p + s * q;
                column[k + 1] = c * q - s * p;
            }
            self.rotate(k + 1, c, s);
        }
    }

    /// Moves to where the multiplier of the constraint that is being added grows by `t`: in primal space along `z`, if there is a
    /// way, in dual space along `r`.
    fn go(&mut self, t: f64, z: Option<&Row>, r: &Row) {
        for k in 0..self.count {
            self.u[k] -= t * r[k];
        }
        if let Some(z) = z {
            add_scaled(&mut self.x, t, z, self.m);
        }
    }

    /// Makes an equality hold.
    fn fix(&mut self, number: usize, equality: &Constraint) -> Result<(), QpFailure> {
        let d = self.project(&equality.a);
        let z = self.primal(&d);
        let r = self.dual(&d);
        let zn = dot(&z, &equality.a, self.m);
        if zn <= 1e-13 {
            // Depends on the equalities before it: harmless if it holds already.
            let holds = self.value(equality).abs() <= 1e-9;
            return if holds { Ok(()) } else { Err(QpFailure::Infeasible) };
        }
        let t = -self.value(equality) / zn;
        self.go(t, Some(&z), &r);
        if !self.add(d, number, t) {
            return Err(QpFailure::Numerical);
        }
        self.fixed = self.count;
        Ok(())
    }

    /// Longest step that keeps the multipliers of the active inequalities positive, and the position of the one that ends it.
    fn dual_limit(&self, r: &Row) -> (f64, usize) {
        let mut limit = (f64::INFINITY, 0);
        for k in self.fixed..self.count {
            if r[k] > 1e-14 && self.u[k] / r[k] < limit.0 {
                limit = (self.u[k] / r[k], k);
            }
        }
        limit
    }

    /// Makes an inequality hold; drops those whose multipliers would turn negative.
    fn activate(
        &mut self,
        number: usize,
        inequality: &Constraint,
        is_active: &mut [bool],
    ) -> Result<(), QpFailure> {
        let mut u = 0.0;
        for _ in 0..4 * WIDTH {
            let d = self.project(&inequality.a);
            let z = self.primal(&d);
            let r = self.dual(&d);
            let (t1, blocking) = self.dual_limit(&r);
            let zn = dot(&z, &inequality.a, self.m);
            let scale = dot(&d, &d, self.m);
            let has_way = zn > 1e-13 * scale.max(1e-12);
            let t2 = if has_way { -self.value(inequality) / zn } else { f64::INFINITY };
            let t = t1.min(t2);
            if t == f64::INFINITY {
                return Err(QpFailure::Infeasible);
            }
            self.go(t, has_way.then_some(&z), &r);
            u += t;
            if t2 <= t1 {
                is_active[number] = true;
                return if self.add(d, number, u) { Ok(()) } else { Err(QpFailure::Numerical) };
            }
            is_active[self.index[blocking]] = false;
            self.drop(blocking);
        }
        Err(QpFailure::Numerical)
    }
}

/// Solves the program of `n` variables.
///
/// `likely` are positions of inequalities that were active in a similar program; they are looked at first.
pub(crate) fn solve(
    factor: &Factor,
    g: &Row,
    n: usize,
    eq: &[Constraint],
    ineq: &[Constraint],
    likely: &[usize],
) -> Result<QpSolution, QpFailure> {
    let mut set = ActiveSet::new(factor, g, n);
    for (number, equality) in eq.iter().enumerate() {
        set.fix(number, equality)?;
    }
    let mut is_active = vec![false; ineq.len()];
    for _ in 0..MAX_CHANGES {
        let Some(number) = most_violated(&set, ineq, likely, &is_active) else {
            let mut solution = QpSolution { d: set.x, eq: vec![0.0; eq.len()], ineq: vec![0.0; ineq.len()] };
            for k in 0..set.count {
                // A dependent equality is not in the set, so positions cannot be used; `fixed` can.
                let into = if k < set.fixed { &mut solution.eq } else { &mut solution.ineq };
                into[set.index[k]] = set.u[k];
            }
            return Ok(solution);
        };
        set.activate(number, &ineq[number], &mut is_active)?;
    }
    Err(QpFailure::Numerical)
}

/// The most violated inequality, measured in its own length; of the likely ones if one of them is violated.
fn most_violated(
    set: &ActiveSet,
    ineq: &[Constraint],
    likely: &[usize],
    is_active: &[bool],
) -> Option<usize> {
    let value = |number: usize| (set.value(&ineq[number]), number);
    let pick = |worst: (f64, usize), now: (f64, usize)| if now.0 < worst.0 { now } else { worst };
    let none = (-1e-11, usize::MAX);
    let first = likely.iter().filter(|k| !is_active[**k]).map(|k| value(*k)).fold(none, pick);
    if first.1 != usize::MAX {
        return Some(first.1);
    }
    let all = (0..ineq.len()).filter(|k| !is_active[*k]).map(value).fold(none, pick);
    (all.1 != usize::MAX).then_some(all.1)
}

/// Bound on active-set changes; programs of this size need some 30.
const MAX_CHANGES: usize = 400;

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f64]) -> Row {
        let mut out = [0.0; WIDTH];
        out[..values.len()].copy_from_slice(values);
        out
    }

    fn random(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*seed >> 33) as f64) / f64::from(1_u32 << 31) * 2.0 - 1.0
    }

    #[test]
    fn kkt_conditions_hold_on_random_programs() {
        let mut seed = 7;
        for case in 0..300 {
            let n = 3 + case % 10;
            let mut h = [[0.0; WIDTH]; WIDTH];
            let m: Vec<Vec<f64>> = (0..n).map(|_| (0..n).map(|_| random(&mut seed)).collect()).collect();
            for i in 0..n {
                for k in 0..n {
                    h[i][k] =
                        (0..n).map(|p| m[p][i] * m[p][k]).sum::<f64>() + f64::from(u8::from(i == k)) * 0.1;
                }
            }
            let g = row(&(0..n).map(|_| random(&mut seed)).collect::<Vec<_>>());
            let equalities = case % 3;
            // A known feasible point makes the program feasible.
            let inside: Vec<f64> = (0..n).map(|_| random(&mut seed)).collect();
            let constraints: Vec<Constraint> = (0..equalities + 2 * n)
                .map(|i| {
                    let a = row(&(0..n).map(|_| random(&mut seed)).collect::<Vec<_>>());
                    let at: f64 = a.iter().zip(&inside).map(|(x, y)| x * y).sum();
                    Constraint {
                        a,
                        c: if i < equalities { -at } else { -at + 0.1 * random(&mut seed).abs() },
                    }
                })
                .collect();
            let factor = Factor::new(&h, n).expect("positive definite");
            let (eq, ineq) = constraints.split_at(equalities);
            let likely: Vec<usize> = (0..ineq.len()).filter(|k| (case + k) % 3 == 0).collect();
            let solution = solve(&factor, &g, n, eq, ineq, &likely).expect("feasible");
            let multipliers: Vec<f64> = solution.eq.iter().chain(&solution.ineq).copied().collect();
            for i in 0..n {
                let mut gradient = g[i] + (0..n).map(|k| h[i][k] * solution.d[k]).sum::<f64>();
                for (constraint, u) in constraints.iter().zip(&multipliers) {
                    gradient -= u * constraint.a[i];
                }
                assert!(gradient.abs() < 1e-8, "case {case}: stationarity {gradient}");
            }
            for (i, (constraint, u)) in constraints.iter().zip(&multipliers).enumerate() {
                let value = dot(&constraint.a, &solution.d, padded(n)) + constraint.c;
                if i < equalities {
                    assert!(value.abs() < 1e-9);
                } else {
                    assert!(value > -1e-9 && *u >= -1e-12 && (value * u).abs() < 1e-8);
                }
            }
        }
    }

    #[test]
    fn contradicting_rows_are_reported_as_infeasible() {
        let mut h = [[0.0; WIDTH]; WIDTH];
        h[0][0] = 1.0;
        h[1][1] = 1.0;
        let factor = Factor::new(&h, 2).expect("positive definite");
        let rows =
            [Constraint { a: row(&[1.0, 1.0]), c: -1.0 }, Constraint { a: row(&[-1.0, -1.0]), c: 0.5 }];
        let failure = solve(&factor, &row(&[0.0, 0.0]), 2, &[], &rows, &[]).unwrap_err();
        assert_eq!(failure, QpFailure::Infeasible);
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut h = [[0.0; WIDTH]; WIDTH];
        h[0][0] = 1.0;
        h[1][1] = -1.0;
        assert!(Factor::new(&h, 2).is_none());
    }
}
