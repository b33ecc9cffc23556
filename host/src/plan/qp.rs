//! Small dense quadratic programs by the dual active-set method.
//!
//! `min ½ dᵀ H d + gᵀ d` subject to `aᵢ d + cᵢ = 0` (equalities) and `aᵢ d + cᵢ ≥ 0` (inequalities), H positive
//! definite. The dual method starts from the unconstrained minimum, so it needs no feasible point, adds one violated
//! row at a time and proves infeasibility when there is none. Source: D. Goldfarb, A. Idnani, "A numerically stable
//! dual method for solving strictly convex quadratic programs", Mathematical Programming 27, 1983.
//!
//! Fixed-size arrays on the stack: a program of the planner has at most 25 variables, and it is solved some ten times
//! per local solve, so allocation would cost more than the arithmetic.

/// Largest number of variables.
pub(crate) const DIM: usize = 25;
/// A row of coefficients.
pub(crate) type Row = [f64; DIM];
/// A square matrix, row by row.
pub(crate) type Square = [Row; DIM];

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

/// Minimiser and multipliers; `multipliers[i]` belongs to constraint `i`, equalities first.
#[derive(Debug, Clone)]
pub(crate) struct QpSolution {
    pub(crate) d: Row,
    pub(crate) multipliers: Vec<f64>,
}

/// Lower Cholesky factor of the leading `n × n` block; `None` if it is not positive definite.
pub(crate) fn cholesky(h: &Square, n: usize) -> Option<Square> {
    let mut l = [[0.0; DIM]; DIM];
    for j in 0..n {
        let mut d = h[j][j];
        for k in 0..j {
            d -= l[j][k] * l[j][k];
        }
        // A pivot that lost all digits to cancellation is as good as a negative one.
        let sound = d > 1e-10 * h[j][j].abs().max(1e-8) && d.is_finite();
        if !sound {
            return None;
        }
        let root = d.sqrt();
        l[j][j] = root;
        for i in j + 1..n {
            let mut v = h[i][j];
            for k in 0..j {
                v -= l[i][k] * l[j][k];
            }
            l[i][j] = v / root;
        }
    }
    Some(l)
}

fn dot(a: &Row, b: &Row, n: usize) -> f64 {
    a.iter().zip(b).take(n).map(|(x, y)| x * y).sum()
}

struct ActiveSet {
    n: usize,
    /// J = L⁻ᵀ Q, row by row.
    j: Square,
    /// Upper triangular R of the active normals.
    r: Square,
    count: usize,
    /// Constraint numbers and their multipliers.
    index: [usize; DIM],
    u: Row,
}

impl ActiveSet {
    /// `d = Jᵀ a`.
    fn project(&self, a: &Row) -> Row {
        let mut d = [0.0; DIM];
        for (row, ai) in self.j.iter().zip(a).take(self.n) {
            if *ai != 0.0 {
                for (dk, jk) in d.iter_mut().zip(row).take(self.n) {
                    *dk += jk * ai;
                }
            }
        }
        d
    }

    /// Step direction in primal space `z = J₂ d₂`.
    fn primal(&self, d: &Row) -> Row {
        let mut z = [0.0; DIM];
        for (zi, row) in z.iter_mut().zip(&self.j).take(self.n) {
            *zi = row[self.count..self.n].iter().zip(&d[self.count..self.n]).map(|(a, b)| a * b).sum();
        }
        z
    }

    /// Step direction in dual space `R⁻¹ d₁`.
    fn dual(&self, d: &Row) -> Row {
        let mut r = [0.0; DIM];
        for i in (0..self.count).rev() {
            let mut v = d[i];
            for k in i + 1..self.count {
                v -= self.r[i][k] * r[k];
            }
            r[i] = v / self.r[i][i];
        }
        r
    }

    /// Adds a constraint whose projection is `d`; false if its normal depends on the active ones.
    fn add(&mut self, mut d: Row, constraint: usize, u: f64) -> bool {
        let n = self.n;
        // Givens rotations of the last entries of d into entry `count`.
        for k in (self.count + 1..n).rev() {
            let (a, b) = (d[k - 1], d[k]);
            if b == 0.0 {
                continue;
            }
            let h = (a * a + b * b).sqrt();
            let (c, s) = (a / h, b / h);
            d[k - 1] = h;
            d[k] = 0.0;
            for row in self.j.iter_mut().take(n) {
                let (p, q) = (row[k - 1], row[k]);
                row[k - 1] = c * p + s * q;
                row[k] = c * q - s * p;
            }
        }
        if d[self.count].abs() <= 1e-12 {
            return false;
        }
        for i in 0..=self.count {
            self.r[i][self.count] = d[i];
        }
        self.index[self.count] = constraint;
        self.u[self.count] = u;
        self.count += 1;
        true
    }

    /// Drops active constraint number `position`.
    fn drop(&mut self, position: usize) {
        let n = self.n;
        for k in position..self.count - 1 {
            self.index[k] = self.index[k + 1];
            self.u[k] = self.u[k + 1];
            for i in 0..self.count {
                self.r[i][k] = self.r[i][k + 1];
            }
        }
        self.count -= 1;
        for k in position..self.count {
            let (a, b) = (self.r[k][k], self.r[k + 1][k]);
            if b == 0.0 {
                continue;
            }
            let h = (a * a + b * b).sqrt();
            let (c, s) = (a / h, b / h);
            for col in k..self.count {
                let (p, q) = (self.r[k][col], self.r[k + 1][col]);
                self.r[k][col] = c * p + s * q;
                self.r[k + 1][col] = c * q - s * p;
            }
            for row in self.j.iter_mut().take(n) {
                let (p, q) = (row[k], row[k + 1]);
                row[k] = c * p + s * q;
                row[k + 1] = c * q - s * p;
            }
        }
    }
}

/// Solves the program of `n` variables; the first `equalities` of `constraints` are equalities.
///
/// `l` is the Cholesky factor of H from [`cholesky`].
pub(crate) fn solve(
    l: &Square,
    g: &Row,
    n: usize,
    constraints: &[Constraint],
    equalities: usize,
) -> Result<QpSolution, QpFailure> {
    // J = L⁻ᵀ by columns of L⁻¹.
    let mut j = [[0.0; DIM]; DIM];
    for k in 0..n {
        // Column k of L⁻¹ becomes row k of J.
        let row = &mut j[k];
        row[k] = 1.0 / l[k][k];
        for i in k + 1..n {
            let mut v = 0.0;
            for m in k..i {
                v -= l[i][m] * row[m];
            }
            row[i] = v / l[i][i];
        }
    }
    let mut set = ActiveSet { n, j, r: [[0.0; DIM]; DIM], count: 0, index: [0; DIM], u: [0.0; DIM] };
    // x = -J Jᵀ g.
    let jg = set.project(g);
    let mut x = [0.0; DIM];
    for (xi, row) in x.iter_mut().zip(&set.j).take(n) {
        *xi = -dot(row, &jg, n);
    }

    for (number, constraint) in constraints.iter().enumerate().take(equalities) {
        let d = set.project(&constraint.a);
        let z = set.primal(&d);
        let r = set.dual(&d);
        let zn = dot(&z, &constraint.a, n);
        if zn <= 1e-13 {
            // Depends on the equalities before it: harmless if it holds already.
            if (dot(&constraint.a, &x, n) + constraint.c).abs() > 1e-9 {
                return Err(QpFailure::Infeasible);
            }
            continue;
        }
        let t = -(dot(&constraint.a, &x, n) + constraint.c) / zn;
        for (xi, zi) in x.iter_mut().zip(&z).take(n) {
            *xi += t * zi;
        }
        for k in 0..set.count {
            set.u[k] -= t * r[k];
        }
        if !set.add(d, number, t) {
            return Err(QpFailure::Numerical);
        }
    }
    let fixed = set.count;

    let mut is_active = vec![false; constraints.len()];
    for _ in 0..MAX_CHANGES {
        // The most violated row, measured in its own length.
        let mut worst = None;
        let mut worst_value = -1e-11;
        for (number, constraint) in constraints.iter().enumerate().skip(equalities) {
            if is_active[number] {
                continue;
            }
            let value = dot(&constraint.a, &x, n) + constraint.c;
            if value < worst_value {
                worst_value = value;
                worst = Some(number);
            }
        }
        let Some(number) = worst else {
            let mut multipliers = vec![0.0; constraints.len()];
            for k in 0..set.count {
                multipliers[set.index[k]] = set.u[k];
            }
            return Ok(QpSolution { d: x, multipliers });
        };
        let constraint = &constraints[number];
        let mut u_new = 0.0;
        let mut s = worst_value;
        let mut inner = 0;
        loop {
            inner += 1;
            if inner > 4 * DIM {
                return Err(QpFailure::Numerical);
            }
            let d = set.project(&constraint.a);
            let z = set.primal(&d);
            let r = set.dual(&d);
            // Longest step that keeps the multipliers of active inequalities positive.
            let mut t1 = f64::INFINITY;
            let mut blocking = 0;
            for k in fixed..set.count {
                if r[k] > 1e-14 {
                    let t = set.u[k] / r[k];
                    if t < t1 {
                        t1 = t;
                        blocking = k;
                    }
                }
            }
            let zn = dot(&z, &constraint.a, n);
            let scale = dot(&d, &d, n);
            let t2 = if zn > 1e-13 * scale.max(1e-12) { -s / zn } else { f64::INFINITY };
            let t = t1.min(t2);
            if t == f64::INFINITY {
                return Err(QpFailure::Infeasible);
            }
            for k in 0..set.count {
                set.u[k] -= t * r[k];
            }
            u_new += t;
            if t2 == f64::INFINITY {
                is_active[set.index[blocking]] = false;
                set.drop(blocking);
                continue;
            }
            for (xi, zi) in x.iter_mut().zip(&z).take(n) {
                *xi += t * zi;
            }
            if t2 <= t1 {
                if !set.add(d, number, u_new) {
                    return Err(QpFailure::Numerical);
                }
                is_active[number] = true;
                break;
            }
            is_active[set.index[blocking]] = false;
            set.drop(blocking);
            s = dot(&constraint.a, &x, n) + constraint.c;
        }
    }
    Err(QpFailure::Numerical)
}

/// Bound on active-set changes; programs of this size need some 30.
const MAX_CHANGES: usize = 400;

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f64]) -> Row {
        let mut out = [0.0; DIM];
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
            let mut h = [[0.0; DIM]; DIM];
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
            let l = cholesky(&h, n).expect("positive definite");
            let solution = solve(&l, &g, n, &constraints, equalities).expect("feasible");
            for i in 0..n {
                let mut gradient = g[i] + (0..n).map(|k| h[i][k] * solution.d[k]).sum::<f64>();
                for (constraint, u) in constraints.iter().zip(&solution.multipliers) {
                    gradient -= u * constraint.a[i];
                }
                assert!(gradient.abs() < 1e-8, "case {case}: stationarity {gradient}");
            }
            for (i, (constraint, u)) in constraints.iter().zip(&solution.multipliers).enumerate() {
                let value = dot(&constraint.a, &solution.d, n) + constraint.c;
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
        let mut h = [[0.0; DIM]; DIM];
        h[0][0] = 1.0;
        h[1][1] = 1.0;
        let l = cholesky(&h, 2).expect("positive definite");
        let rows =
            [Constraint { a: row(&[1.0, 1.0]), c: -1.0 }, Constraint { a: row(&[-1.0, -1.0]), c: 0.5 }];
        assert_eq!(solve(&l, &row(&[0.0, 0.0]), 2, &rows, 0).unwrap_err(), QpFailure::Infeasible);
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut h = [[0.0; DIM]; DIM];
        h[0][0] = 1.0;
        h[1][1] = -1.0;
        assert!(cholesky(&h, 2).is_none());
    }
}
