//! Every exported symbol against triple loops, defining equations and LAPACK's info codes, over
//! random sizes, leading dimensions, operands and factors. Called through the C ABI, as the solver does.

use core::ffi::c_char;
use lapack_shim::symbols::*;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

/// Column-major storage with `pad` extra rows, filled with a marker that must survive.
#[derive(Clone, Debug)]
struct Stored {
    data: Vec<f64>,
    ld: i32,
}

const MARK: f64 = 7.25e77;

impl Stored {
    fn new(m: &DMatrix<f64>, pad: usize) -> Self {
        let ld = (m.nrows() + pad).max(1);
        let mut data = vec![MARK; ld * m.ncols().max(1)];
        for j in 0..m.ncols() {
            for i in 0..m.nrows() {
                data[j * ld + i] = m[(i, j)];
            }
        }
        Self { data, ld: ld as i32 }
    }

    fn matrix(&self, rows: usize, cols: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, cols, |i, j| self.data[j * self.ld as usize + i])
    }

    /// Whether nothing outside rows x cols was touched.
    fn padding_intact(&self, rows: usize) -> bool {
        self.data.chunks(self.ld as usize).all(|c| c[rows.min(c.len())..].iter().all(|x| *x == MARK))
    }
}

/// Small deterministic generator: numbers in [-1, 1).
fn random(rows: usize, cols: usize, seed: u64) -> DMatrix<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    DMatrix::from_fn(rows, cols, |_, _| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    })
}

fn symmetric(n: usize, seed: u64) -> DMatrix<f64> {
    let a = random(n, n, seed);
    (&a + a.transpose()) * 0.5
}

/// Only the stored triangle of `full`; the other one holds the marker, so that reading it shows.
fn triangle(full: &DMatrix<f64>, upper: bool) -> DMatrix<f64> {
    DMatrix::from_fn(full.nrows(), full.ncols(), |i, j| {
        if (upper && i <= j) || (!upper && i >= j) { full[(i, j)] } else { MARK }
    })
}

fn ch(c: u8) -> c_char {
    c as c_char
}

fn op(m: &DMatrix<f64>, t: bool) -> DMatrix<f64> {
    if t { m.transpose() } else { m.clone() }
}

fn naive(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(a.nrows(), b.ncols(), |i, j| (0..a.ncols()).map(|k| a[(i, k)] * b[(k, j)]).sum())
}

fn factor() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(1.0), Just(-1.0), -3.0..3.0]
}

fn trans() -> impl Strategy<Value = (u8, bool)> {
    prop_oneof![Just((b'N', false)), Just((b'T', true)), Just((b't', true)), Just((b'C', true))]
}

fn increment() -> impl Strategy<Value = i32> {
    prop_oneof![Just(1), Just(2), Just(-1), Just(-3)]
}

/// A BLAS vector with increment: storage and the logical vector.
fn strided(x: &DVector<f64>, inc: i32) -> Vec<f64> {
    let (n, step) = (x.len(), inc.unsigned_abs() as usize);
    let mut data = vec![MARK; if n == 0 { 1 } else { 1 + (n - 1) * step }];
    for i in 0..n {
        data[if inc > 0 { i * step } else { (n - 1 - i) * step }] = x[i];
    }
    data
}

fn unstride(data: &[f64], n: usize, inc: i32) -> DVector<f64> {
    let step = inc.unsigned_abs() as usize;
    DVector::from_fn(n, |i, _| data[if inc > 0 { i * step } else { (n - 1 - i) * step }])
}

fn close(a: &DMatrix<f64>, b: &DMatrix<f64>) -> bool {
    a.shape() == b.shape() && a.iter().zip(b.iter()).all(|(x, y)| (x - y).abs() <= 1e-12 * (1.0 + y.abs()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn dgemm_equals_the_triple_loop(
        (m, n, k) in (0usize..12, 0usize..12, 0usize..12), pads in (0usize..3, 0usize..3, 0usize..3),
        ta in trans(), tb in trans(), alpha in factor(), beta in factor(), seed in 1u64..u64::MAX,
    ) {
        let a = if ta.1 { random(k, m, seed) } else { random(m, k, seed) };
        let b = if tb.1 { random(n, k, seed ^ 1) } else { random(k, n, seed ^ 1) };
        let c = random(m, n, seed ^ 2);
        // beta = 0 must not read C: poison it then.
        let c0 = if beta == 0.0 { DMatrix::from_element(m, n, f64::NAN) } else { c.clone() };
        let (sa, sb, mut sc) = (Stored::new(&a, pads.0), Stored::new(&b, pads.1), Stored::new(&c0, pads.2));
        let (mi, ni, ki) = (m as i32, n as i32, k as i32);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            dgemm_(&ch(ta.0), &ch(tb.0), &mi, &ni, &ki, &alpha, sa.data.as_ptr(), &sa.ld,
                   sb.data.as_ptr(), &sb.ld, &beta, sc.data.as_mut_ptr(), &sc.ld);
        }
        let want = naive(&op(&a, ta.1), &op(&b, tb.1)) * alpha + if beta == 0.0 { c * 0.0 } else { c * beta };
        prop_assert!(close(&sc.matrix(m, n), &want));
        prop_assert!(sc.padding_intact(m));
    }

    #[test]
    fn dgemv_and_dsymv_equal_the_double_loop(
        (m, n) in (0usize..9, 0usize..9), pad in 0usize..3, ta in trans(), upper in any::<bool>(),
        alpha in factor(), beta in factor(), incx in increment(), incy in increment(), seed in 1u64..u64::MAX,
    ) {
        let a = random(m, n, seed);
        let (lx, ly) = if ta.1 { (m, n) } else { (n, m) };
        let x = random(lx, 1, seed ^ 3).column(0).into_owned();
        let y = random(ly, 1, seed ^ 4).column(0).into_owned();
        let sa = Stored::new(&a, pad);
        let (sx, mut sy) = (strided(&x, incx), strided(&y, incy));
        let (mi, ni) = (m as i32, n as i32);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            dgemv_(&ch(ta.0), &mi, &ni, &alpha, sa.data.as_ptr(), &sa.ld, sx.as_ptr(), &incx, &beta,
                   sy.as_mut_ptr(), &incy);
        }
        let want = op(&a, ta.1) * &x * alpha + &y * beta;
        prop_assert!((unstride(&sy, ly, incy) - want).amax() < 1e-12);

        let s = symmetric(n, seed ^ 5);
        let (x, y) = (random(n, 1, seed ^ 6).column(0).into_owned(), random(n, 1, seed ^ 7).column(0).into_owned());
        let sa = Stored::new(&triangle(&s, upper), pad);
        let (sx, mut sy) = (strided(&x, incx), strided(&y, incy));
        let uplo = ch(if upper { b'U' } else { b'L' });
        // SAFETY: as above.
        unsafe {
            dsymv_(&uplo, &ni, &alpha, sa.data.as_ptr(), &sa.ld, sx.as_ptr(), &incx, &beta, sy.as_mut_ptr(), &incy);
        }
        let want = s * &x * alpha + &y * beta;
        prop_assert!((unstride(&sy, n, incy) - want).amax() < 1e-12);
    }

    #[test]
    fn rank_k_updates_write_one_triangle_and_leave_the_other(
        (n, k) in (0usize..12, 0usize..12), pad in 0usize..3, ta in trans(), upper in any::<bool>(),
        alpha in factor(), beta in factor(), seed in 1u64..u64::MAX,
    ) {
        let shape = |t: bool| if t { (k, n) } else { (n, k) };
        let (rows, cols) = shape(ta.1);
        let (a, b) = (random(rows, cols, seed), random(rows, cols, seed ^ 1));
        let c = symmetric(n, seed ^ 2);
        let (sa, sb) = (Stored::new(&a, pad), Stored::new(&b, pad));
        let uplo = ch(if upper { b'U' } else { b'L' });
        let (ni, ki) = (n as i32, k as i32);
        let (oa, ob) = (op(&a, ta.1), op(&b, ta.1));

        let mut sc = Stored::new(&triangle(&c, upper), pad);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            dsyrk_(&uplo, &ch(ta.0), &ni, &ki, &alpha, sa.data.as_ptr(), &sa.ld, &beta, sc.data.as_mut_ptr(), &sc.ld);
        }
        let want = naive(&oa, &oa.transpose()) * alpha + &c * beta;
        prop_assert!(close(&sc.matrix(n, n), &triangle(&want, upper)));

        let mut sc = Stored::new(&triangle(&c, upper), pad);
        // SAFETY: as above.
        unsafe {
            dsyr2k_(&uplo, &ch(ta.0), &ni, &ki, &alpha, sa.data.as_ptr(), &sa.ld, sb.data.as_ptr(), &sb.ld,
                    &beta, sc.data.as_mut_ptr(), &sc.ld);
        }
        let cross = naive(&oa, &ob.transpose());
        let want = (&cross + cross.transpose()) * alpha + &c * beta;
        prop_assert!(close(&sc.matrix(n, n), &triangle(&want, upper)));
        prop_assert!(sc.padding_intact(n));
    }

    #[test]
    fn dpotrf_and_dpotrs_factor_and_solve(
        n in 0usize..10, nrhs in 0usize..4, pad in 0usize..3, upper in any::<bool>(), seed in 1u64..u64::MAX,
    ) {
        let g = random(n, n, seed);
        let spd = &g * g.transpose() + DMatrix::identity(n, n) * 0.1;
        let mut sa = Stored::new(&triangle(&spd, upper), pad);
        let uplo = ch(if upper { b'U' } else { b'L' });
        let (ni, ri, mut info) = (n as i32, nrhs as i32, 99);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe { dpotrf_(&uplo, &ni, sa.data.as_mut_ptr(), &sa.ld, &mut info) };
        prop_assert_eq!(info, 0);
        let raw = sa.matrix(n, n);
        let f = DMatrix::from_fn(n, n, |i, j| if (upper && i <= j) || (!upper && i >= j) { raw[(i, j)] } else { 0.0 });
        let back = if upper { f.tr_mul(&f) } else { &f * f.transpose() };
        prop_assert!(close(&back, &spd));
        let stored = |i: usize, j: usize| (upper && i <= j) || (!upper && i >= j);
        let other_kept = (0..n * n).all(|k| stored(k / n, k % n) || raw[(k / n, k % n)] == MARK);
        prop_assert!(other_kept);

        let x = random(n, nrhs, seed ^ 1);
        let mut sb = Stored::new(&(&spd * &x), pad);
        // SAFETY: as above.
        unsafe { dpotrs_(&uplo, &ni, &ri, sa.data.as_ptr(), &sa.ld, sb.data.as_mut_ptr(), &sb.ld, &mut info) };
        prop_assert_eq!(info, 0);
        let residual = &spd * sb.matrix(n, nrhs) - &spd * &x;
        prop_assert!(residual.iter().all(|r| r.abs() < 1e-9));
        prop_assert!(sb.padding_intact(n));
    }

    #[test]
    fn dpotrf_names_the_first_minor_that_is_not_positive(
        n in 1usize..8, bad in 0usize..8, upper in any::<bool>(), seed in 1u64..u64::MAX,
    ) {
        let bad = bad % n;
        let g = random(n, n, seed);
        let mut a = &g * g.transpose() + DMatrix::identity(n, n);
        a[(bad, bad)] = -1.0;
        let mut sa = Stored::new(&a, 1);
        let (uplo, ni, mut info) = (ch(if upper { b'U' } else { b'L' }), n as i32, 99);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe { dpotrf_(&uplo, &ni, sa.data.as_mut_ptr(), &sa.ld, &mut info) };
        prop_assert_eq!(info, bad as i32 + 1);
    }

    #[test]
    fn dgesv_solves_and_reports_its_pivots(
        n in 0usize..10, nrhs in 0usize..4, pad in 0usize..3, seed in 1u64..u64::MAX,
    ) {
        let a = random(n, n, seed);
        let b = random(n, nrhs, seed ^ 1);
        let (mut sa, mut sb) = (Stored::new(&a, pad), Stored::new(&b, pad));
        let (ni, ri, mut info, mut ipiv) = (n as i32, nrhs as i32, 99, vec![0i32; n]);
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            dgesv_(&ni, &ri, sa.data.as_mut_ptr(), &sa.ld, ipiv.as_mut_ptr(), sb.data.as_mut_ptr(), &sb.ld, &mut info);
        }
        prop_assert_eq!(info, 0);
        prop_assert!((&a * sb.matrix(n, nrhs) - &b).iter().all(|r| r.abs() < 1e-8));
        // P A = L U with the exchanges of ipiv.
        let lu = sa.matrix(n, n);
        let l = DMatrix::from_fn(n, n, |i, j| if i > j { lu[(i, j)] } else if i == j { 1.0 } else { 0.0 });
        let u = DMatrix::from_fn(n, n, |i, j| if i <= j { lu[(i, j)] } else { 0.0 });
        let mut pa = a.clone();
        for (j, p) in ipiv.iter().enumerate() {
            pa.swap_rows(j, *p as usize - 1);
        }
        prop_assert!(close(&(l * u), &pa));
    }

    #[test]
    fn dsyevr_gives_ascending_eigenpairs(
        n in 0usize..12, pad in 0usize..3, upper in any::<bool>(), scale in -12i32..12, seed in 1u64..u64::MAX,
    ) {
        let scale = 10f64.powi(scale);
        let a = symmetric(n, seed) * scale;
        let (w, z) = eigen(&a, upper, pad, b'A', (0, 0), (0.0, 0.0));
        prop_assert_eq!(w.len(), n);
        // Without vectors another routine runs.
        let alone = eigenvalues(&a, upper, pad);
        prop_assert!(alone.windows(2).all(|p| p[0] <= p[1]));
        prop_assert!(w.iter().zip(&alone).all(|(x, y)| (x - y).abs() < 1e-14 * scale * (n as f64 + 1.0)));
        prop_assert!(w.windows(2).all(|p| p[0] <= p[1]));
        let residual = &a * &z - &z * DMatrix::from_diagonal(&DVector::from_vec(w));
        prop_assert!(residual.iter().all(|r| r.abs() < 1e-13 * scale * (n as f64 + 1.0)));
        prop_assert!((z.tr_mul(&z) - DMatrix::identity(n, n)).iter().all(|r| r.abs() < 1e-13));
    }

    #[test]
    fn both_singular_value_routines_rebuild_the_matrix(
        (m, n) in (1usize..9, 1usize..9), pad in 0usize..3, rank in 1usize..9, grade in 0.0f64..12.0, seed in 1u64..u64::MAX,
    ) {
        let rank = rank.min(m).min(n);
        // Graded and rank-deficient products are what an interior-point scaling meets near its end.
        let d = DMatrix::from_fn(rank, rank, |i, j| if i == j { 10f64.powf(-grade * i as f64 / rank as f64) } else { 0.0 });
        let a = random(m, rank, seed) * d * random(rank, n, seed ^ 1);
        for qr in [false, true] {
            let (info, u, s, vt) = singular(&a, pad, qr, b'S');
            prop_assert_eq!(info, 0);
            prop_assert!(s.windows(2).all(|p| p[0] >= p[1]) && s.iter().all(|x| *x >= 0.0));
            let back = &u * DMatrix::from_diagonal(&DVector::from_vec(s.clone())) * &vt;
            prop_assert!((back - &a).amax() < 1e-12);
            let r = m.min(n);
            prop_assert!((u.tr_mul(&u) - DMatrix::identity(r, r)).amax() < 1e-11);
            prop_assert!((&vt * vt.transpose() - DMatrix::identity(r, r)).amax() < 1e-11);
            let (info, _, only, _) = singular(&a, pad, qr, b'N');
            prop_assert_eq!(info, 0);
            prop_assert_eq!(only, s);
        }
    }
}

/// Eigenvalues without vectors (`jobz = 'N'`).
fn eigenvalues(a: &DMatrix<f64>, upper: bool, pad: usize) -> Vec<f64> {
    eigen_of(b'N', a, upper, pad, b'A', (0, 0), (0.0, 0.0)).0
}

fn eigen(
    a: &DMatrix<f64>,
    upper: bool,
    pad: usize,
    range: u8,
    indices: (i32, i32),
    values: (f64, f64),
) -> (Vec<f64>, DMatrix<f64>) {
    eigen_of(b'V', a, upper, pad, range, indices, values)
}

fn eigen_of(
    job: u8,
    a: &DMatrix<f64>,
    upper: bool,
    pad: usize,
    range: u8,
    (il, iu): (i32, i32),
    (vl, vu): (f64, f64),
) -> (Vec<f64>, DMatrix<f64>) {
    let n = a.nrows();
    let mut sa = Stored::new(&triangle(a, upper), pad);
    let mut z = Stored::new(&DMatrix::zeros(n, n), pad);
    let (ni, mut m, mut w, mut isuppz, mut info) = (n as i32, 0, vec![0.0; n], vec![0; 2 * n.max(1)], 99);
    let (mut work, mut iwork) = (vec![0.0], vec![0]);
    let uplo = ch(if upper { b'U' } else { b'L' });
    let mut sizes = (-1, -1);
    for _ in 0..2 {
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            dsyevr_(
                &ch(job),
                &ch(range),
                &uplo,
                &ni,
                sa.data.as_mut_ptr(),
                &sa.ld,
                &vl,
                &vu,
                &il,
                &iu,
                &-1.0,
                &mut m,
                w.as_mut_ptr(),
                z.data.as_mut_ptr(),
                &z.ld,
                isuppz.as_mut_ptr(),
                work.as_mut_ptr(),
                &sizes.0,
                iwork.as_mut_ptr(),
                &sizes.1,
                &mut info,
            );
        }
        assert_eq!(info, 0);
        sizes = (work[0] as i32, iwork[0]);
        work.resize(sizes.0 as usize, 0.0);
        iwork.resize(sizes.1 as usize, 0);
    }
    w.truncate(m as usize);
    (w, z.matrix(n, m as usize))
}

type Singular = (i32, DMatrix<f64>, Vec<f64>, DMatrix<f64>);

fn singular(a: &DMatrix<f64>, pad: usize, qr: bool, job: u8) -> Singular {
    let (m, n) = a.shape();
    let r = m.min(n);
    let mut sa = Stored::new(a, pad);
    let (mut u, mut vt) = (Stored::new(&DMatrix::zeros(m, r), pad), Stored::new(&DMatrix::zeros(r, n), pad));
    let (mi, ni, mut s, mut work, mut info) = (m as i32, n as i32, vec![0.0; r], vec![0.0], 99);
    let (mut iwork, mut lwork) = (vec![0; 8 * r], -1);
    for _ in 0..2 {
        // SAFETY: all pointers are to live values and storage of the stated shapes.
        unsafe {
            if qr {
                dgesvd_(
                    &ch(job),
                    &ch(job),
                    &mi,
                    &ni,
                    sa.data.as_mut_ptr(),
                    &sa.ld,
                    s.as_mut_ptr(),
                    u.data.as_mut_ptr(),
                    &u.ld,
                    vt.data.as_mut_ptr(),
                    &vt.ld,
                    work.as_mut_ptr(),
                    &lwork,
                    &mut info,
                );
            } else {
                dgesdd_(
                    &ch(job),
                    &mi,
                    &ni,
                    sa.data.as_mut_ptr(),
                    &sa.ld,
                    s.as_mut_ptr(),
                    u.data.as_mut_ptr(),
                    &u.ld,
                    vt.data.as_mut_ptr(),
                    &vt.ld,
                    work.as_mut_ptr(),
                    &lwork,
                    iwork.as_mut_ptr(),
                    &mut info,
                );
            }
        }
        if info != 0 {
            break;
        }
        lwork = work[0] as i32;
        work.resize(lwork as usize, 0.0);
    }
    (info, u.matrix(m, r), s, vt.matrix(r, n))
}

#[test]
fn dsyevr_selects_by_index_and_by_value() {
    let a = DMatrix::from_diagonal(&DVector::from_vec(vec![3.0, -1.0, 2.0, 5.0]));
    assert_eq!(eigen(&a, true, 1, b'I', (2, 3), (0.0, 0.0)).0, vec![2.0, 3.0]);
    // (vl, vu]: open below, closed above.
    assert_eq!(eigen(&a, false, 0, b'V', (0, 0), (2.0, 5.0)).0, vec![3.0, 5.0]);
    assert_eq!(eigen(&DMatrix::zeros(4, 4), true, 0, b'A', (0, 0), (0.0, 0.0)).0, vec![0.0; 4]);
}

/// What the closed forms and the shift of the iteration meet at their edges: clusters, zeros, halves that do not touch.
#[test]
fn eigenvalues_of_special_matrices_are_exact() {
    let repeated = DMatrix::from_fn(9, 9, |i, j| if i == j { 2.0 } else { 0.0 });
    assert_eq!(eigenvalues(&repeated, true, 0), vec![2.0; 9]);
    // All ones: n and zeros. Swap of two halves: pairs of +1 and -1 with a zero diagonal.
    let ones = eigenvalues(&DMatrix::from_element(6, 6, 1.0), false, 1);
    assert!(ones[..5].iter().all(|x| x.abs() < 1e-14) && (ones[5] - 6.0).abs() < 1e-14, "{ones:?}");
    let swap = DMatrix::from_fn(8, 8, |i, j| if (i + 4) % 8 == j { 1.0 } else { 0.0 });
    let swap = eigenvalues(&swap, true, 0);
    assert!(swap[..4].iter().all(|x| (x + 1.0).abs() < 1e-14), "{swap:?}");
    assert!(swap[4..].iter().all(|x| (x - 1.0).abs() < 1e-14), "{swap:?}");
    // Second difference: 2 - 2 cos(k pi / (n + 1)).
    let n = 10;
    let difference = DMatrix::from_fn(n, n, |i, j| match i.abs_diff(j) {
        0 => 2.0,
        1 => -1.0,
        _ => 0.0,
    });
    for (k, x) in (1..).zip(eigenvalues(&difference, true, 2)) {
        let want = 2.0 - 2.0 * (f64::from(k) * std::f64::consts::PI / 11.0).cos();
        assert!((x - want).abs() < 1e-14, "{k}: {x} {want}");
    }
}

#[test]
fn a_singular_system_is_reported_and_the_right_side_kept() {
    let a = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 3.0, 2.0, 4.0, 6.0, 1.0, 0.0, 1.0]);
    let b = DMatrix::from_element(3, 1, 1.5);
    let (mut sa, mut sb) = (Stored::new(&a, 0), Stored::new(&b, 0));
    let (mut info, mut ipiv) = (0, [0; 3]);
    // SAFETY: all pointers are to live values and storage of the stated shapes.
    unsafe {
        dgesv_(&3, &1, sa.data.as_mut_ptr(), &3, ipiv.as_mut_ptr(), sb.data.as_mut_ptr(), &3, &mut info);
    };
    assert_eq!(info, 3);
    assert_eq!(sb.matrix(3, 1), b);
}

#[test]
fn wrong_arguments_get_the_number_of_the_argument() {
    let (mut a, mut b, mut s, mut info) = ([1.0; 16], [1.0; 16], [0.0; 4], 0);
    let (mut work, mut ipiv, mut m) = ([0.0; 200], [0; 80], 0);
    let (w, ip) = (work.as_mut_ptr(), ipiv.as_mut_ptr());
    let (pa, pb, ps) = (a.as_mut_ptr(), b.as_mut_ptr(), s.as_mut_ptr());
    let mut case = |want: i32, call: &mut dyn FnMut(&mut i32)| {
        info = 77;
        call(&mut info);
        assert_eq!(info, want);
    };
    // SAFETY: every array holds the largest shape named below, and refused calls touch none.
    unsafe {
        case(-1, &mut |i| dpotrf_(&ch(b'X'), &2, pa, &2, i));
        case(-2, &mut |i| dpotrf_(&ch(b'U'), &-1, pa, &2, i));
        case(-4, &mut |i| dpotrf_(&ch(b'U'), &3, pa, &2, i));
        case(-3, &mut |i| dpotrs_(&ch(b'L'), &2, &-1, pa, &2, pb, &2, i));
        case(-7, &mut |i| dpotrs_(&ch(b'L'), &2, &1, pa, &2, pb, &1, i));
        case(-1, &mut |i| dgesv_(&-2, &1, pa, &2, ip, pb, &2, i));
        case(-4, &mut |i| dgesv_(&2, &1, pa, &1, ip, pb, &2, i));
        let mut eig = |job: u8, range: u8, n: i32, lda: i32, ldz: i32, lw: i32, liw: i32, i: &mut i32| {
            dsyevr_(
                &ch(job),
                &ch(range),
                &ch(b'U'),
                &n,
                pa,
                &lda,
                &0.0,
                &0.0,
                &0,
                &0,
                &0.0,
                &mut m,
                ps,
                pb,
                &ldz,
                ip,
                w,
                &lw,
                ip,
                &liw,
                i,
            );
        };
        case(-1, &mut |i| eig(b'Q', b'A', 2, 2, 2, 200, 80, i));
        case(-2, &mut |i| eig(b'V', b'Z', 2, 2, 2, 200, 80, i));
        case(-6, &mut |i| eig(b'V', b'A', 2, 1, 2, 200, 80, i));
        case(-15, &mut |i| eig(b'V', b'A', 2, 2, 1, 200, 80, i));
        case(-18, &mut |i| eig(b'V', b'A', 2, 2, 2, 3, 80, i));
        case(-20, &mut |i| eig(b'V', b'A', 2, 2, 2, 200, 3, i));
        // A full basis of a rectangle and overwriting are refused rather than half done.
        case(-1, &mut |i| dgesdd_(&ch(b'O'), &2, &2, pa, &2, ps, pb, &2, pb, &2, w, &99, ip, i));
        case(-1, &mut |i| dgesdd_(&ch(b'A'), &2, &3, pa, &2, ps, pb, &2, pb, &3, w, &99, ip, i));
        case(-2, &mut |i| dgesvd_(&ch(b'A'), &ch(b'A'), &2, &3, pa, &2, ps, pb, &2, pb, &3, w, &99, i));
        case(-12, &mut |i| dgesdd_(&ch(b'S'), &2, &2, pa, &2, ps, pb, &2, pb, &2, w, &0, ip, i));
    }
}

#[test]
fn numbers_that_are_lost_end_in_an_info_code_not_in_a_loop() {
    let a = DMatrix::from_element(4, 4, f64::NAN);
    assert_eq!(singular(&a, 0, false, b'S').0, 1);
    assert_eq!(singular(&a, 0, true, b'S').0, 1);
    let (mut sa, mut info) = (Stored::new(&a, 0), 0);
    // SAFETY: all pointers are to live values and storage of the stated shapes.
    unsafe { dpotrf_(&ch(b'L'), &4, sa.data.as_mut_ptr(), &4, &mut info) };
    assert_eq!(info, 1);
}
