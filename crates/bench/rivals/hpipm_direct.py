"""HPIPM called as its own library, as acados calls it: only what is bounded has bounds, nothing is copied twice.

CasADi's wheel has HPIPM over a BLASFEO for any x86-64 (no AVX), and its interface puts bounds of 1e8 on every state.
Where a wheel of acados is unpacked, HPIPM over a BLASFEO for AVX2 can be measured beside it:

    pip download --no-deps comma-deps-acados && unzip -q comma_deps_acados-*.whl -d acados
    export HPIPM_INSTALL=$(echo $PWD/acados/*/purelib/acados/install)    # has include/ and lib/
"""

import ctypes
import os
import pathlib
import subprocess

import numpy as np

SOURCE = r"""
#include <stdlib.h>
#include "hpipm_d_ocp_qp.h"
#include "hpipm_d_ocp_qp_dim.h"
#include "hpipm_d_ocp_qp_ipm.h"
#include "hpipm_d_ocp_qp_sol.h"
#include "hpipm_d_part_cond.h"

static struct d_ocp_qp_dim dim;
static struct d_ocp_qp qp;
static struct d_ocp_qp_sol sol;
static struct d_ocp_qp_ipm_arg arg;
static struct d_ocp_qp_ipm_ws ws;
static struct d_ocp_qp_dim small_dim;
static struct d_ocp_qp small_qp;
static struct d_ocp_qp_sol small_sol;
static struct d_part_cond_qp_arg cond;
static struct d_part_cond_qp_ws cond_ws;
static int N, nx, nu, condenses;

static void *room(size_t bytes) { return aligned_alloc(64, (bytes + 127) / 64 * 64); }

/* x0 is no variable; stages are condensed into `blocks` where those are fewer */
void setup(int steps, int states, int inputs, int mode, double tolerance, int iterations, int warm, int blocks) {
    N = steps; nx = states; nu = inputs; condenses = blocks < steps;
    d_ocp_qp_dim_create(N, &dim, room(d_ocp_qp_dim_memsize(N)));
    for (int k = 0; k <= N; k++) {
        d_ocp_qp_dim_set_nx(k, k ? nx : 0, &dim);
        d_ocp_qp_dim_set_nu(k, k < N ? nu : 0, &dim);
        d_ocp_qp_dim_set_nbx(k, 0, &dim);
        d_ocp_qp_dim_set_nbu(k, k < N ? nu : 0, &dim);
        d_ocp_qp_dim_set_ng(k, 0, &dim);
        d_ocp_qp_dim_set_ns(k, 0, &dim);
    }
    d_ocp_qp_create(&dim, &qp, room(d_ocp_qp_memsize(&dim)));
    d_ocp_qp_sol_create(&dim, &sol, room(d_ocp_qp_sol_memsize(&dim)));
    struct d_ocp_qp_dim *solved = &dim;
    if (condenses) {
        int sizes[1024];
        d_ocp_qp_dim_create(blocks, &small_dim, room(d_ocp_qp_dim_memsize(blocks)));
        d_part_cond_qp_compute_block_size(N, blocks, sizes);
        d_part_cond_qp_compute_dim(&dim, sizes, &small_dim);
        d_part_cond_qp_arg_create(blocks, &cond, room(d_part_cond_qp_arg_memsize(blocks)));
        d_part_cond_qp_arg_set_default(&cond);
        d_part_cond_qp_arg_set_ric_alg(0, &cond);
        d_part_cond_qp_ws_create(&dim, sizes, &small_dim, &cond, &cond_ws,
                                 room(d_part_cond_qp_ws_memsize(&dim, sizes, &small_dim, &cond)));
        d_ocp_qp_create(&small_dim, &small_qp, room(d_ocp_qp_memsize(&small_dim)));
        d_ocp_qp_sol_create(&small_dim, &small_sol, room(d_ocp_qp_sol_memsize(&small_dim)));
        solved = &small_dim;
    }
    d_ocp_qp_ipm_arg_create(solved, &arg, room(d_ocp_qp_ipm_arg_memsize(solved)));
    d_ocp_qp_ipm_arg_set_default(mode, &arg);
    d_ocp_qp_ipm_arg_set_tol_stat(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_eq(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_ineq(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_tol_comp(&tolerance, &arg);
    d_ocp_qp_ipm_arg_set_iter_max(&iterations, &arg);
    d_ocp_qp_ipm_arg_set_warm_start(&warm, &arg);
    d_ocp_qp_ipm_ws_create(solved, &arg, &ws, room(d_ocp_qp_ipm_ws_memsize(solved, &arg)));
    int index[64];
    for (int i = 0; i < nu; i++) index[i] = i;
    double *zero = calloc(nx * nu, sizeof(double));
    for (int k = 0; k < N; k++) {
        d_ocp_qp_set_idxbu(k, index, &qp);
        if (k) d_ocp_qp_set_S(k, zero, &qp);
    }
    free(zero);
}

/* blocks column-major, stage after stage; z is u0 x1 u1 x2 ... */
int solve(double *A, double *B, double *c, double *Q, double *q, double *R, double *r, double *QN, double *qN,
          double *low, double *high, double *z, int *iterations) {
    for (int k = 0; k < N; k++) {
        if (k) {
            d_ocp_qp_set_A(k, A + k * nx * nx, &qp);
            d_ocp_qp_set_Q(k, Q + k * nx * nx, &qp);
            d_ocp_qp_set_q(k, q + k * nx, &qp);
        }
        d_ocp_qp_set_B(k, B + k * nx * nu, &qp);
        d_ocp_qp_set_b(k, c + k * nx, &qp);
        d_ocp_qp_set_R(k, R + k * nu * nu, &qp);
        d_ocp_qp_set_r(k, r + k * nu, &qp);
        d_ocp_qp_set_lbu(k, low + k * nu, &qp);
        d_ocp_qp_set_ubu(k, high + k * nu, &qp);
    }
    d_ocp_qp_set_Q(N, QN, &qp);
    d_ocp_qp_set_q(N, qN, &qp);
    if (condenses) {
        d_part_cond_qp_cond(&qp, &small_qp, &cond, &cond_ws);
        d_ocp_qp_ipm_solve(&small_qp, &small_sol, &arg, &ws);
        d_part_cond_qp_expand_sol(&qp, &small_qp, &small_sol, &sol, &cond, &cond_ws);
    } else {
        d_ocp_qp_ipm_solve(&qp, &sol, &arg, &ws);
    }
    for (int k = 0; k < N; k++) {
        d_ocp_qp_sol_get_u(k, &sol, z + k * (nu + nx));
        d_ocp_qp_sol_get_x(k + 1, &sol, z + k * (nu + nx) + nu);
    }
    int status;
    d_ocp_qp_ipm_get_status(&ws, &status);
    d_ocp_qp_ipm_get_iter(&ws, iterations);
    return status;
}
"""
MODES = {"speed_abs": 0, "speed": 1, "balance": 2, "robust": 3}


def install():
    """Where HPIPM's `include` and `lib` are, or None."""
    place = os.environ.get("HPIPM_INSTALL")
    return pathlib.Path(place) if place else None


class Direct:
    """One QP, its stages condensed into `blocks` where given; `warm` is HPIPM's: 0 not at all, 2 primal and dual."""

    def __init__(self, folder, steps, states, inputs, mode, tolerance, warm, blocks=None, iterations=50):
        source, library = folder / "direct.c", folder / "direct.so"
        source.write_text(SOURCE)
        place = install()
        include = [f"-I{place}/include/{k}/include" for k in ("hpipm", "blasfeo")]
        paths = f"-Wl,--no-as-needed,--disable-new-dtags,-rpath,{place}/lib"
        link = [paths, f"-L{place}/lib", "-lhpipm", "-lblasfeo"]
        command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", *include, str(source), "-o", str(library), *link]
        subprocess.run(command, check=True)
        self.library = ctypes.CDLL(str(library))
        self.library.setup(
            steps, states, inputs, MODES[mode], ctypes.c_double(tolerance), iterations, warm, blocks or steps
        )
        self.answer = np.zeros(steps * (states + inputs))
        self.iterations = ctypes.c_int()
        self.arguments = None

    def read_from(self, arrays):
        """A, B, c, Q, q, R, r, Q_N, q_N, least and most of the inputs."""
        point = lambda a: a.ctypes.data_as(ctypes.c_void_p)
        self.arguments = [*(point(a) for a in arrays), point(self.answer), ctypes.byref(self.iterations)]
        self.call = self.library.solve

    def run(self):
        return self.call(*self.arguments)
