"""Reference throw for the control comparison: the published throw re-optimised (cost 31.699).

Prints, for the 6-joint throwing arm, the release state of h and the sensitivity of the landing
point to joint errors at the release, from forward kinematics and central differences alone
(numpy only; nothing of the Rust code). The output is embedded in host/src/tune/throw.rs.
"""
import numpy as np

DH = [(0, 0, 0.27), (-90, 0, 0), (180, 0.29, 0), (-90, 0, 0.5), (-90, 0, 0), (90, 0, 0.217)]
TARGET, G = np.array([1.0, 1.0, -1.0]), np.array([0, 0, -9.81])
BALL = np.array([[0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0.05], [0, 0, 0, 1.0]])


def fk(q):
    X = np.eye(4)
    for (alpha, a, d), qi in zip(DH, q):
        ca, sa, c, s = np.cos(np.radians(alpha)), np.sin(np.radians(alpha)), np.cos(qi), np.sin(qi)
        X = X @ np.array([[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]])
    return X @ BALL


def jac(q, eps=1e-6):
    R = fk(q)[:3, :3]
    J = np.zeros((6, 6))
    for i in range(6):
        e = np.zeros(6)
        e[i] = eps
        a, b = fk(q + e), fk(q - e)
        J[:3, i] = (a[:3, 3] - b[:3, 3]) / (2 * eps)
        W = (a[:3, :3] - b[:3, :3]) / (2 * eps) @ R.T
        J[3:, i] = [W[2, 1], W[0, 2], W[1, 0]]
    return J


def rot(axis, t):
    c, s = np.cos(t), np.sin(t)
    return np.array({"y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])


def release(h, q0):
    th, ph, r, ga, om, F = h[:6]
    p0 = np.array([0, 0, 0.27]) + r * np.array([np.cos(ph) * np.cos(th), np.cos(ph) * np.sin(th), np.sin(ph)])
    v0 = (TARGET - p0) / F - G * F / 2
    az, polar = np.arctan2(v0[1], v0[0]), np.arccos(v0[2] / np.linalg.norm(v0))
    R = rot("z", az) @ rot("y", polar) @ rot("z", ga)
    q = np.array(q0, float)
    for _ in range(200):
        X = fk(q)
        E = R @ X[:3, :3].T
        err = np.r_[p0 - X[:3, 3], 0.5 * np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])]
        step = np.linalg.solve(jac(q), err)
        q += step * min(1, 0.2 / (np.abs(step).max() + 1e-12))
    assert np.abs(err).max() < 1e-9, err
    return q, np.linalg.solve(jac(q), np.r_[v0, om * R[:, 2]])


def landing(q, qd):
    """Where the ball passes the height of the target, from the joint state at the release."""
    p, v = fk(q)[:3, 3], jac(q)[:3] @ qd
    t = (v[2] + np.sqrt(v[2] ** 2 - 2 * 9.81 * (TARGET[2] - p[2]))) / 9.81
    return (p + v * t)[:2]


if __name__ == "__main__":
    start = [0.199999, 0.125428, -1.856562, 1.004064, 1.387908, 1.654417]
    q, qd = release([0.493, -0.465, 0.858, 0.583, -1.098, 0.586], start)
    assert np.allclose(qd, [1.358402, -1.675786, 0.482325, -0.010697, -0.986023, 2.548397], atol=2e-3), qd
    q, qd = release([0.3055, -0.3997, 0.8697, 0.2442, -0.919, 0.5831], start)
    print("q_rad    ", np.array2string(q, separator=", ", precision=6))
    print("qd_rad_s ", np.array2string(qd, separator=", ", precision=6))
    print("landing  ", landing(q, qd))
    for name, which in (("d_landing_d_q (m/rad)", 0), ("d_landing_d_qd (m s/rad)", 1)):
        D = np.zeros((2, 6))
        for i in range(6):
            e = np.zeros(6)
            e[i] = 1e-4
            up = landing(q + e, qd) if which == 0 else landing(q, qd + e)
            dn = landing(q - e, qd) if which == 0 else landing(q, qd - e)
            D[:, i] = (up - dn) / 2e-4
        print(name, np.array2string(D, separator=", ", precision=6))
