/* The quadratic program of a window: its constraints C x, its objective, and their derivatives.
 *
 *     min  1/2 x'H x + g'x   over the steps x = (X, tau) of [Q; v] at nodes 1 .. K and of the free durations,
 *     s.t. low <= C x <= high,
 *          Q_k+1 - Q_k - a_k v_k - b_k v_k+1 - Gamma_k tau + gap_k = 0   on the intervals k = 0 .. K - 1.
 *
 * The rows of C are, in order (their number is `row_count`):
 *
 *     [Q; v] at nodes 1 .. K                          2NK   bounds of states
 *     the durations tau                               S
 *     their sums tau_1 + .. + tau_s                   S
 *     constraints at nodes, c [Q; v]                  E     those of row_node and row_jacobian
 *     constraints on intervals, less low h_k          I     those of interval_row and interval_jacobian, >= 0
 *     the same, less high h_k                         I     <= 0
 *     v_k+1 - v_k - u_low h_k                         NK    accelerations from below, >= 0
 *     v_k+1 - v_k - u_high h_k                        NK    accelerations from above, <= 0
 *
 * with h_k the step of the length of interval k, and constraints on intervals c [Q; v at both ends; tau; v_k-1], the last
 * part in kernels with a HISTORY alone. The last two are there if `has_input_rows`. Rows of states and of constraints at nodes may be soft: what violates their bounds by e
 * costs `penalty` e.
 */

/* A program as its callers pass it; psmpc_cli/solvers/quadratic.py declares the same structure, and compares the
 * offsets of all members when it loads the library. */
typedef struct {
    int64_t K;                          /* intervals */
    int64_t S;                          /* free durations, at most S_MAX */
    int64_t node_row_count;             /* E, constraints at nodes */
    int64_t interval_row_count;         /* I, constraints on intervals */
    int64_t has_input_rows;             /* whether accelerations are bounded */
    int64_t max_iterations;
    double tolerance;                   /* residuals and complementarity at which a program is solved */
    double acceptable_tolerance;        /* the same where the method gets no further */
    double initial_barrier;             /* first product of a slack and its multiplier */
    double bound_push;                  /* smallest first slack */
    const double *H_QQ;                 /* Hessian by Q at nodes 1 .. K, the upper triangles, (K, N, N) */
    const double *gradient;             /* g by [Q; v] there, (K, 2N) */
    const double *gradient_tau;         /* g by tau, (S,) */
    const double *H_vv;                 /* -R: Hessian by the velocities before and after an interval, (K, N) */
    const double *H_x_tau;              /* Hessian by [Q; v] at nodes 1 .. K and tau, (K, 2N, S) */
    const double *H_tau_tau;            /* Hessian by tau, (S, S) */
    const double *gap_velocity;         /* -a and -b, derivatives of the gaps by the velocities, (K, 2) */
    const double *gap_tau;              /* -Gamma, derivatives of the gaps by tau, (K, N, S) */
    const double *gaps;                 /* the gaps at x = 0, (K, N) */
    const int64_t *row_node;            /* nodes of the constraints at nodes, from node 1, ascending, (E,) */
    const double *row_jacobian;         /* their derivatives by [Q; v] there, (E, 2N) */
    const int64_t *interval_row;        /* intervals of the constraints on intervals, ascending, (I,) */
    const double *interval_jacobian;    /* their derivatives by [Q; v] at both ends, tau and v_k-1, (I, 4N + S + HISTORY) */
    const double *interval_low;         /* their bounds over h, (I,) */
    const double *interval_high;
    const double *interval_weight;      /* w of those that are residuals, which have no bounds and add w c'c to H; else 0 */
    const double *low;                  /* bounds of all rows, infinite where there is none, (rows,) */
    const double *high;
    const double *input_low;            /* u_low, u_high (K, N) */
    const double *input_high;
    const double *interval_by_duration; /* derivatives of the lengths h of the intervals by tau, (K, S) */
    const double *penalty;              /* cost of a violation of 1 of a soft row; 0 of a hard one, (rows,) */
    double *X;                          /* out: (K, 2N) */
    double *tau;                        /* out: (S,) */
    double *gap_multipliers;            /* out: (K, N) */
    double *row_multipliers;            /* out: of all rows, > 0 at an upper bound, < 0 at a lower one */
    double *report;                     /* out: iterations, primal residual, dual residual, complementarity */
    double *workspace;                  /* memory, aligned for vectors */
} QuadraticProgram;

/* Inequalities d = sign (row - bound) >= 0, one for each finite bound of a row; one array for each quantity, (count,).
 * Each has a slack s and a multiplier z. A point on the central path meets
 *
 *     d - s = 0,   s z = mu.
 *
 * A soft inequality may be violated by e >= 0, at a cost of `penalty` e; w is the multiplier of e >= 0:
 *
 *     d + e - s = 0,   s z = mu,   e w = mu,   z + w = penalty.
 *
 * Newton's equations of the last two are (e + de) w - e dz = mu + de_a dz_a, with the product of the affine step in
 * Mehrotra's corrector, so
 *
 *     e + de = shift + relaxation dz,   shift = (mu + de_a dz_a) / w,   relaxation = e / w.
 *
 * Both e and w are eliminated so: what is left of a soft inequality is a hard one, d + shift + relaxation dz - s = 0.
 * Nocedal, Wright: Numerical Optimization (2006), sections 16.6 and 17.2 (exact penalties); Frison, Diehl: HPIPM (2020)
 * eliminates soft constraints alike. */
typedef struct {
    int64_t count;
    int64_t *row;
    double *sign;
    double *distance; /* d */
    double *slack;
    double *multiplier;
    double *slack_step;
    double *multiplier_step;
    double *inverse_pivot; /* 1 / (s + delta z), see interior_point.c */
    /* of soft ones: */
    double *violation;
    double *violation_multiplier;
    double *violation_step;
    double *relaxation;
    double *relaxation_shift;
} Inequalities;

/* Equations row = target: residuals, multipliers y and their steps, (count,). */
typedef struct {
    int64_t count;
    int64_t *row;
    double *residual;
    double *multiplier;
    double *multiplier_step;
} Equations;

/* What lasts from one iteration to the next, and the memory of an iteration. */
typedef struct {
    const QuadraticProgram *program;
    double max_row_weight;  /* 1 / delta: the greatest weight of a row in the Hessian */
    double primal_residual; /* largest residual of an inequality or equation */
    double complementarity; /* sum of s z and e w over all inequalities: the duality gap */
    Inequalities hard;
    Inequalities soft;
    Equations equations;
    RiccatiData riccati;
    IntervalGains *intervals;  /* (K,); of a program with constraints on intervals the next five instead */
    DenseTableau *dense;       /* (K,) */
    IntervalRows dense_rows;
    double *dense_weights;     /* of `dense_rows`, (I,) */
    vec (*dense_y)[Y_VECS];    /* of the same, (I, Y_VECS) */
    Pattern *dense_patterns;   /* of the same, (I,) */
    double *tau_by_gaps;       /* what the gaps add to their derivatives by tau, Gamma' c_Q+, (I, S) */
    double *row_weights;       /* W of all rows; those of [Q; v] come first, as in the next two */
    double *row_multipliers;   /* of all rows */
    double *row_steps;         /* C dx */
    double *control_gradients; /* (K, N), padded */
    double *cost_gradient;     /* H x + g by [Q; v], (K, 2N) */
    double *cost_gradient_tau; /* by tau, (S,) */
    double *gradient;          /* of the Lagrangian without the gaps, by [Q; v], (K, 2N) */
    double *gradient_tau;      /* by tau, (S,) */
    double *reduced_gradient;  /* by the velocities, (K, N) */
    double *tau_step;          /* (S,) */
    double *schur;             /* Hessian by tau after all states are eliminated, (S, S) */
    double *schur_factor;      /* its factors L and D, (S, S) */
    double *H_x_tau;           /* of H + C'W C, (K, 2N, S) */
    double *R;                 /* (K, N) */
    double *H_tau_tau;         /* (S, S) */
    vec *H_QQ;                 /* of H, (K, N, N), padded */
} InteriorPoint;

/* Return the number of rows of C. */
static int64_t row_count(const QuadraticProgram *program) {
    const int64_t S = program->S;
    int64_t input_rows = program->has_input_rows ? 2 * program->K * N : 0;
    return program->K * NX + 2 * S + program->node_row_count + 2 * program->interval_row_count + input_rows;
}

/* Tell whether a row may be violated at a cost. */
static int is_soft(const QuadraticProgram *program, int64_t row) {
    return program->penalty[row] > 0.0;
}

/* Return the step of the length of an interval. */
static double length_step(const QuadraticProgram *program, int64_t k, const double *tau) {
    const int64_t S = program->S;
    double h = 0.0;
    for (int c = 0; c < S; c++) h += program->interval_by_duration[k * S + c] * tau[c];
    return h;
}

/* Return the product of two vectors. */
INLINE double dot(const double *one, const double *other, int count) {
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int i = 0; i < count; i++) sum += one[i] * other[i];
    return sum;
}

/* Compute c x of a constraint or residual on an interval at x = (X, tau). */
static double interval_value(const QuadraticProgram *program, int64_t i, const double *X, const double *tau) {
    const int64_t S = program->S;
    int64_t k = program->interval_row[i];
    const double *c = program->interval_jacobian + i * INTERVAL_ROW;
    double value = k ? dot(c, X + (k - 1) * NX, 2 * NX) : dot(c + NX, X, NX);
    for (int e = 0; e < S; e++) value += c[2 * NX + e] * tau[e];
    if (HISTORY && k > 1) value += dot(c + 2 * NX + S, X + (k - 2) * NX + N, HISTORY);
    return value;
}

/* Add y c to (X, tau). */
static void add_interval_row(const QuadraticProgram *program, int64_t i, double y, double *restrict X,
                             double *restrict tau) {
    const int64_t S = program->S;
    int64_t k = program->interval_row[i];
    const double *c = program->interval_jacobian + i * INTERVAL_ROW;
    for (int j = 0; j < NX && k; j++) X[(k - 1) * NX + j] += y * c[j];
    for (int j = 0; j < NX; j++) X[k * NX + j] += y * c[NX + j];
    for (int e = 0; e < S; e++) tau[e] += y * c[2 * NX + e];
    for (int j = 0; j < HISTORY && k > 1; j++) X[(k - 2) * NX + N + j] += y * c[2 * NX + S + j];
}

/* Compute C x at x = (X, tau). The first 2NK `rows` are X, which the caller has set; this sets those behind. */
static void apply_rows(const QuadraticProgram *program, const double *tau, double *rows) {
    const int64_t S = program->S;
    const double *X = rows;
    double *out = rows + program->K * NX;
    double sum = 0.0;
    for (int c = 0; c < S; c++) {
        sum += tau[c];
        out[c] = tau[c];
        out[S + c] = sum;
    }
    out += 2 * S;
    for (int64_t e = 0; e < program->node_row_count; e++) {
        out[e] = dot(program->row_jacobian + e * NX, X + program->row_node[e] * NX, NX);
    }
    out += program->node_row_count;
    for (int64_t i = 0; i < program->interval_row_count; i++) {
        double h = length_step(program, program->interval_row[i], tau);
        double value = interval_value(program, i, X, tau);
        out[i] = value - program->interval_low[i] * h;
        out[program->interval_row_count + i] = value - program->interval_high[i] * h;
    }
    out += 2 * program->interval_row_count;
    if (!program->has_input_rows) return;
    for (int64_t k = 0; k < program->K; k++) {
        double h = length_step(program, k, tau);
        for (int i = 0; i < N; i++) {
            double velocity_change = X[k * NX + N + i] - (k ? X[(k - 1) * NX + N + i] : 0.0);
            out[k * N + i] = velocity_change - program->input_low[k * N + i] * h;
            out[(program->K + k) * N + i] = velocity_change - program->input_high[k * N + i] * h;
        }
    }
}

/* Add C'y to (X, tau), the transpose of `apply_rows`; y has an entry for each row. */
static void add_rows_transposed(const QuadraticProgram *program, const double *y, double *restrict X,
                                double *restrict tau) {
    const int64_t S = program->S;
    for (int64_t i = 0; i < program->K * NX; i++) X[i] += y[i];
    y += program->K * NX;
    double of_sums = 0.0; /* tau_c is in the sums from its own on */
    for (int c = S - 1; c >= 0; c--) {
        of_sums += y[S + c];
        tau[c] += y[c] + of_sums;
    }
    y += 2 * S;
    for (int64_t e = 0; e < program->node_row_count; e++)
        for (int i = 0; i < NX; i++) X[program->row_node[e] * NX + i] += y[e] * program->row_jacobian[e * NX + i];
    y += program->node_row_count;
    for (int64_t i = 0; i < program->interval_row_count; i++) {
        int64_t k = program->interval_row[i];
        double y_low = y[i];
        double y_high = y[program->interval_row_count + i];
        double by_h = y_low * program->interval_low[i] + y_high * program->interval_high[i];
        add_interval_row(program, i, y_low + y_high, X, tau);
        for (int e = 0; e < S; e++) tau[e] -= by_h * program->interval_by_duration[k * S + e];
    }
    y += 2 * program->interval_row_count;
    if (!program->has_input_rows) return;
    for (int64_t k = 0; k < program->K; k++)
        for (int i = 0; i < N; i++) {
            double y_low = y[k * N + i];
            double y_high = y[(program->K + k) * N + i];
            double by_h = y_low * program->input_low[k * N + i] + y_high * program->input_high[k * N + i];
            X[k * NX + N + i] += y_low + y_high;
            if (k) X[(k - 1) * NX + N + i] -= y_low + y_high;
            for (int c = 0; c < S; c++) tau[c] -= by_h * program->interval_by_duration[k * S + c];
        }
}

/* Compute the gradient H x + g of the objective at x = (X, tau) into cost_gradient and cost_gradient_tau. H has the
 * blocks `H_QQ` by Q_k, R by v_k+1 - v_k, `H_x_tau` by states and durations, `H_tau_tau` by tau, and w c'c of the
 * residuals on intervals. */
static void compute_cost_gradient(InteriorPoint *ip, const double *X, const double *tau) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    memcpy(ip->cost_gradient, program->gradient, program->K * NX * sizeof(double));
    for (int c = 0; c < S; c++) {
        ip->cost_gradient_tau[c] = program->gradient_tau[c];
        for (int e = 0; e < S; e++) ip->cost_gradient_tau[c] += program->H_tau_tau[c * S + e] * tau[e];
    }
    for (int64_t k = 0; k < program->K; k++) {
        const double *x = X + k * NX;
        double *g = ip->cost_gradient + k * NX;
        vec by_Q[N_VECS];
        memset(by_Q, 0, sizeof by_Q);
        for (int j = 0; j < N; j++)
            for (int v = 0; v < N_VECS; v++) by_Q[v] += x[j] * ip->H_QQ[(k * N + j) * N_VECS + v];
        for (int i = 0; i < N; i++) g[i] += const_scalars(by_Q)[i];
        for (int i = 0; i < N; i++) {
            double by_change = -program->H_vv[k * N + i] * (x[N + i] - (k ? x[N + i - NX] : 0.0));
            g[N + i] += by_change;
            if (k) g[N + i - NX] -= by_change;
        }
        for (int i = 0; i < NX; i++)
            for (int c = 0; c < S; c++) {
                g[i] += program->H_x_tau[(k * NX + i) * S + c] * tau[c];
                ip->cost_gradient_tau[c] += program->H_x_tau[(k * NX + i) * S + c] * x[i];
            }
    }
    for (int64_t i = 0; i < program->interval_row_count; i++) {
        double weight = program->interval_weight[i];
        if (weight == 0.0) continue;
        double value = interval_value(program, i, X, tau);
        add_interval_row(program, i, weight * value, ip->cost_gradient, ip->cost_gradient_tau);
    }
}

/* Reduce derivatives by (X, tau) to those by the velocities and tau: the positions follow from both by the gaps. The
 * multipliers lambda_k of the gaps make the derivatives by the positions vanish, the adjoint of the dynamics:
 *
 *     lambda_k-1 = lambda_k - df/dQ_k,   lambda_K = 0,
 *     by v_k     df/dv_k - b_k-1 lambda_k-1 - a_k lambda_k,
 *     by tau     df/dtau - sum of Gamma_k' lambda_k.
 *
 * In: by_X (K, 2N), by_tau (S,). Out: by_velocity (K, N), gap_multipliers (K, N), and by_tau in place. Nocedal, Wright
 * (2006), section 15.3: elimination of variables by linear constraints. */
static void compute_reduced_gradient(const QuadraticProgram *program, const double *by_X, double *by_tau,
                                     double *by_velocity, double *gap_multipliers) {
    const int64_t S = program->S;
    double lambda[N] = {0};
    double lambda_next[N];
    for (int64_t k = program->K - 1; k >= 0; k--) {
        double minus_b = program->gap_velocity[2 * k + 1];
        double minus_a_next = k + 1 < program->K ? program->gap_velocity[2 * k + 2] : 0.0;
        for (int i = 0; i < N; i++) {
            lambda_next[i] = lambda[i];
            lambda[i] -= by_X[k * NX + i];
            by_velocity[k * N + i] = by_X[k * NX + N + i] + minus_b * lambda[i] + minus_a_next * lambda_next[i];
            gap_multipliers[k * N + i] = lambda[i];
            for (int c = 0; c < S; c++) by_tau[c] += lambda[i] * program->gap_tau[(k * N + i) * S + c];
        }
    }
}
