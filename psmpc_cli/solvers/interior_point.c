/* A primal-dual interior-point method for the quadratic programs of a window, on the recursion in recursion.c.
 *
 * It is Mehrotra's predictor-corrector method: Nocedal, Wright: Numerical Optimization (2006), algorithm 16.4. States
 * follow from the steps of velocities and durations by the gaps, and the multipliers of the gaps from the gradient by
 * their adjoint: both hold to rounding at every iterate.
 *
 * Multipliers are proximal: half the square of their change is charged with delta = 1 / max_row_weight. That bounds the
 * weight a row gets in the Hessian, and vanishes at the solution: Friedlander, Orban: A primal-dual regularized
 * interior-point method for convex quadratic programs (2012). Newton's equations of an inequality, C dx being the steps
 * of the rows, are
 *
 *     d + sign C dx + delta dz - (s + ds) = 0,
 *     s z + z ds + s dz = mu - ds_a dz_a,
 *
 * with the product of the affine step (ds_a, dz_a) in the corrector. A soft inequality has d + shift for d and
 * delta + relaxation for delta, see program.c. Eliminating ds,
 *
 *     dz = (mu - ds_a dz_a - z (d + sign C dx)) / (s + delta z).
 *
 * So the multiplier z + dz adds the weight z / (s + delta z) to the Hessian by its row. Newton's equation of a row that
 * is an equation, with the residual r, is r + C dx - delta dy = 0: its weight is 1 / delta.
 */

#define MAX_ROW_WEIGHT 1e9         /* greatest weight of a row in the Hessian */
#define MIN_ROW_WEIGHT 1e4         /* bound of that where rounding has made a Hessian indefinite */
#define FRACTION_TO_BOUNDARY 0.995 /* largest part of the way to where a slack or multiplier is 0 */
#define FINAL_CENTERING 0.1        /* part of the tolerance that the complementarity is steered to at the end */
#define MIN_STEP_LENGTH 1e-9       /* a step of which no part is longer gets nowhere */
#define UNBOUNDED_STEP 1e3         /* longest step of an unbounded unknown in a proof of infeasibility */
#define PIVOT_ROUNDING 1e-13       /* size of a pivot that may be rounding alone, by the entry that it is left of */

/* How a program ended, in the order of `QpStatus` in quadratic.py. */
enum { SOLVED, INFEASIBLE, NOT_CONVEX, FAILED };

/* Functions of inequalities take them by value, since compilers take the arrays of a struct behind a pointer for
 * scattered ones, and `soft` as a constant, so that each is compiled once for hard and once for soft ones. */

/* What the ratio test of a step finds, over all inequalities: the largest relative decreases, at least 1, and the sums
 * from which the complementarity after a step of any lengths follows. */
typedef struct {
    double primal;       /* largest of -ds / s and -de / e */
    double dual;         /* largest of -dz / z and -dw / w */
    double slack_change; /* sum of z ds and w de */
    double step_product; /* sum of ds dz and de dw, where dw = -dz */
} RatioTest;

/* Compute relaxation = e / w of soft inequalities, and inverse_pivot = 1 / (s + delta z), of soft ones with
 * delta + relaxation for delta. */
INLINE void compute_pivots(Inequalities ineq, int soft, double delta) {
#pragma omp simd
    for (int64_t j = 0; j < ineq.count; j++) {
        if (soft) ineq.relaxation[j] = ineq.violation[j] / ineq.violation_multiplier[j];
        double regularization = soft ? delta + ineq.relaxation[j] : delta;
        ineq.inverse_pivot[j] = 1.0 / (ineq.slack[j] + ineq.multiplier[j] * regularization);
    }
}

/* Set the steps dz to their parts without C dx,
 *
 *     dz = (mu - ds_a dz_a - z d) / (s + delta z),   soft: d + shift for d, shift = (mu + de_a dz_a) / w.
 *
 * The affine step is that of the call before; `corrected` is 1 with the corrector, 0 without. */
INLINE void form_right_hand_side(Inequalities ineq, int soft, double mu, double corrected) {
#pragma omp simd
    for (int64_t j = 0; j < ineq.count; j++) {
        double distance = ineq.distance[j];
        if (soft) {
            double product = corrected * ineq.violation_step[j] * ineq.multiplier_step[j];
            ineq.relaxation_shift[j] = (mu + product) / ineq.violation_multiplier[j];
            distance += ineq.relaxation_shift[j];
        }
        double product = corrected * ineq.slack_step[j] * ineq.multiplier_step[j];
        ineq.multiplier_step[j] = (mu - product - ineq.multiplier[j] * distance) * ineq.inverse_pivot[j];
    }
}

/* Recover the steps of the inequalities from those of the rows, C dx, and apply the ratio test:
 *
 *     dz -= z sign C dx / (s + delta z),   ds = d + sign C dx - s + delta dz;
 *     soft: e + de = shift + relaxation dz, which is added to ds. */
INLINE void recover_steps(Inequalities ineq, int soft, const double *row_steps, double delta, RatioTest *test) {
    double primal = test->primal;
    double dual = test->dual;
    double slack_change = test->slack_change;
    double step_product = test->step_product;
#pragma omp simd reduction(max : primal, dual) reduction(+ : slack_change, step_product)
    for (int64_t j = 0; j < ineq.count; j++) {
        double distance_step = ineq.sign[j] * row_steps[ineq.row[j]];
        double dz = ineq.multiplier_step[j] - ineq.multiplier[j] * ineq.inverse_pivot[j] * distance_step;
        double ds = ineq.distance[j] + distance_step - ineq.slack[j] + dz * delta;
        if (soft) {
            double next_violation = ineq.relaxation_shift[j] + ineq.relaxation[j] * dz;
            double de = next_violation - ineq.violation[j];
            double violation_decrease = -de / ineq.violation[j];
            double multiplier_decrease = dz / ineq.violation_multiplier[j];
            primal = primal > violation_decrease ? primal : violation_decrease;
            dual = dual > multiplier_decrease ? dual : multiplier_decrease;
            slack_change += ineq.violation_multiplier[j] * de;
            step_product -= de * dz;
            ineq.violation_step[j] = de;
            ds += next_violation;
        }
        double slack_decrease = -ds / ineq.slack[j];
        double multiplier_decrease = -dz / ineq.multiplier[j];
        primal = primal > slack_decrease ? primal : slack_decrease;
        dual = dual > multiplier_decrease ? dual : multiplier_decrease;
        slack_change += ineq.multiplier[j] * ds;
        step_product += ds * dz;
        ineq.multiplier_step[j] = dz;
        ineq.slack_step[j] = ds;
    }
    *test = (RatioTest){primal, dual, slack_change, step_product};
}

/* Take a step of the lengths alpha_p (d, s, e) and alpha_d (z, w):
 *
 *     s += alpha_p ds,   z += alpha_d dz,   e += alpha_p de,   w -= alpha_d dz.
 *
 * Out: `residual`, the largest of its value before and |d + e - s|; `complementarity` plus the sum of s z and e w. */
INLINE void step_inequalities(Inequalities ineq, int soft, const double *row_steps, double alpha_p, double alpha_d,
                              double *residual, double *complementarity) {
    double largest = *residual;
    double sum = *complementarity;
#pragma omp simd reduction(max : largest) reduction(+ : sum)
    for (int64_t j = 0; j < ineq.count; j++) {
        ineq.distance[j] += alpha_p * ineq.sign[j] * row_steps[ineq.row[j]];
        ineq.slack[j] += alpha_p * ineq.slack_step[j];
        ineq.multiplier[j] += alpha_d * ineq.multiplier_step[j];
        double infeasibility = ineq.distance[j] - ineq.slack[j];
        sum += ineq.slack[j] * ineq.multiplier[j];
        if (soft) {
            ineq.violation[j] += alpha_p * ineq.violation_step[j];
            ineq.violation_multiplier[j] -= alpha_d * ineq.multiplier_step[j];
            infeasibility += ineq.violation[j];
            sum += ineq.violation[j] * ineq.violation_multiplier[j];
        }
        infeasibility = fabs(infeasibility);
        largest = largest > infeasibility ? largest : infeasibility;
    }
    *residual = largest;
    *complementarity = sum;
}

/* Subtract sign (z + alpha dz) from the multipliers y of the rows: the multiplier of a row is positive at its upper
 * bound, where sign is -1. */
static void add_inequality_multipliers(Inequalities ineq, double alpha, double *y) {
    for (int64_t j = 0; j < ineq.count; j++) {
        double multiplier = ineq.multiplier[j] + alpha * ineq.multiplier_step[j];
        y[ineq.row[j]] -= ineq.sign[j] * multiplier;
    }
}

/* Add z / (s + delta z) to the weights of the rows. */
static void add_inequality_weights(Inequalities ineq, double *weights) {
    for (int64_t j = 0; j < ineq.count; j++) weights[ineq.row[j]] += ineq.multiplier[j] * ineq.inverse_pivot[j];
}

/* Write the two rows of each constraint on an interval, c - low h with the weight w_l and c - high h with w_h, as one of
 * their common weight: with the parts t_l and t_h of the two by tau,
 *
 *     w = w_l + w_h,   t = (w_l t_l + w_h t_h) / w,
 *
 * and what that leaves of the Hessian by tau, w_l t_l t_l' + w_h t_h t_h' - w t t', is added to `H_tau_tau`. A residual
 * has its own weight, and neither w_l nor w_h. */
static void form_interval_rows(InteriorPoint *ip, const double *weights) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    int64_t count = program->interval_row_count;
    for (int64_t i = 0; i < count; i++) {
        const double *by_duration = program->interval_by_duration + program->interval_row[i] * S;
        const double *by_tau = program->interval_jacobian + i * INTERVAL_ROW + 2 * NX;
        double weight_low = weights[i];
        double weight_high = weights[count + i];
        double weight = weight_low + weight_high;
        const double *by_gaps = ip->tau_by_gaps + i * S;
        double *y_tau = scalars(ip->dense_y[i]) + Y_Q_COLUMN + N;
        ip->dense_weights[i] = weight + program->interval_weight[i];
        double share_high = weight > 0.0 ? weight_high / weight : 0.0;
        double width = program->interval_high[i] - program->interval_low[i];
        double bound = program->interval_low[i] + share_high * width;
        double left = weight_low * share_high * width * width;
        for (int c = 0; c < S; c++) {
            y_tau[c] = by_gaps[c] + (by_tau[c] - bound * by_duration[c]);
            for (int e = 0; e < S; e++) ip->H_tau_tau[c * S + e] += left * by_duration[c] * by_duration[e];
        }
    }
}

/* Form the Hessian of the Newton equations, H + C'W C, with the weights W of the rows: z / (s + delta z) of an
 * inequality, 1 / delta of an equation. Nocedal, Wright (2006), section 16.6.
 *
 * Bounds of states and rows at nodes get their weights in `riccati`, which adds them node by node. A duration's own
 * bound adds to the diagonal of `H_tau_tau`, that of tau_1 + .. + tau_s to all of its first s rows and columns. The row
 * dv - u h of an acceleration, h = sum of h_c tau_c, adds
 *
 *     w to R,   -+ w u h_c to `H_x_tau` by the velocity after and before,   w u^2 h_c h_e to `H_tau_tau`. */
NOINLINE void form_hessian(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    double delta = 1.0 / ip->max_row_weight;
    compute_pivots(ip->hard, 0, delta);
    compute_pivots(ip->soft, 1, delta);
    memset(ip->row_weights, 0, row_count(program) * sizeof(double));
    add_inequality_weights(ip->hard, ip->row_weights);
    add_inequality_weights(ip->soft, ip->row_weights);
    for (int64_t j = 0; j < ip->equations.count; j++) ip->row_weights[ip->equations.row[j]] = ip->max_row_weight;
    const double *weights = ip->row_weights + program->K * NX;
    memcpy(ip->H_tau_tau, program->H_tau_tau, S * S * sizeof(double));
    for (int j = 0; j < S; j++) {
        ip->H_tau_tau[j * S + j] += weights[j];
        for (int c = 0; c <= j; c++)
            for (int e = 0; e <= j; e++) ip->H_tau_tau[c * S + e] += weights[S + j];
    }
    ip->riccati.node_row_weights = weights + 2 * S;
    for (int64_t i = 0; i < program->K * N; i++) ip->R[i] = -program->H_vv[i];
    weights += 2 * S + program->node_row_count;
    form_interval_rows(ip, weights);
    weights += 2 * program->interval_row_count;
    if (!program->has_input_rows) return;
    memcpy(ip->H_x_tau, program->H_x_tau, program->K * NX * S * sizeof(double));
    for (int64_t k = 0; k < program->K; k++)
        for (int i = 0; i < N; i++) {
            double weight_low = weights[k * N + i];
            double weight_high = weights[(program->K + k) * N + i];
            double u_low = program->input_low[k * N + i];
            double u_high = program->input_high[k * N + i];
            ip->R[k * N + i] += weight_low + weight_high;
            for (int c = 0; c < S; c++) {
                double by_tau = program->interval_by_duration[k * S + c];
                double by_velocity_and_tau = (weight_low * u_low + weight_high * u_high) * by_tau;
                double by_tau_and_h = (weight_low * u_low * u_low + weight_high * u_high * u_high) * by_tau;
                ip->H_x_tau[(k * NX + N + i) * S + c] -= by_velocity_and_tau;
                if (k) ip->H_x_tau[((k - 1) * NX + N + i) * S + c] += by_velocity_and_tau;
                for (int e = 0; e < S; e++)
                    ip->H_tau_tau[c * S + e] += by_tau_and_h * program->interval_by_duration[k * S + e];
            }
        }
}

/* Factorize the Hessian by the durations after all states are eliminated, U = L D L' (S, S), and tell by the signs of D
 * whether it is positive definite: Sylvester's law of inertia, Golub, Van Loan: Matrix Computations (2013), section 8.1.5.
 *
 * What eliminations leave of a direction without curvature is rounding, of either sign: a pivot that is smaller than the
 * rounding of the entry by the durations that it is left of takes that size, which `solve_schur` refines.
 *
 * Out: L below the diagonal of schur_factor, D on it. Returns 0 where a pivot is negative, or no number. */
static int factorize_schur(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    double *L = ip->schur_factor;
    for (int c = 0; c < S; c++) {
        double rounding = PIVOT_ROUNDING * fmax(fabs(ip->H_tau_tau[c * S + c]), fabs(ip->schur[c * S + c]));
        for (int e = 0; e <= c; e++) {
            double sum = ip->schur[c * S + e];
            for (int l = 0; l < e; l++) sum -= L[c * S + l] * L[l * S + l] * L[e * S + l];
            L[c * S + e] = e < c ? sum / L[e * S + e] : sum;
        }
        double *pivot = L + c * S + c;
        if (!(*pivot >= -rounding)) return 0;
        *pivot = fmax(*pivot, fmax(rounding, DBL_MIN));
    }
    return 1;
}

/* Add the solution of L D L'x = -r to x. In: r (S,), which is overwritten. */
static void add_schur_solution(int64_t S, const double *L, double *r, double *x) {
    for (int c = 0; c < S; c++)
        for (int e = 0; e < c; e++) r[c] -= L[c * S + e] * r[e];
    for (int c = S - 1; c >= 0; c--) {
        r[c] /= L[c * S + c];
        for (int e = c + 1; e < S; e++) r[c] -= L[e * S + c] * r[e];
        x[c] -= r[c];
    }
}

/* Solve U x = -u for the steps of the durations, with one step of iterative refinement: Golub, Van Loan (2013), section
 * 3.5.3. */
static void solve_schur(const InteriorPoint *ip, const double *u, double *x) {
    const int64_t S = ip->program->S;
    double residual[S_MAX + 1]; /* one to spare, for S_MAX = 0 */
    memcpy(residual, u, S * sizeof(double));
    memset(x, 0, S * sizeof(double));
    add_schur_solution(S, ip->schur_factor, residual, x);
    for (int c = 0; c < S; c++) {
        residual[c] = u[c];
        for (int e = 0; e < S; e++) residual[c] += ip->schur[c * S + e] * x[e];
    }
    add_schur_solution(S, ip->schur_factor, residual, x);
}

/* Compute the gradient of the Lagrangian without the gaps, H x + g + C'y, with the multipliers y in row_multipliers. */
static void compute_gradient(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    memcpy(ip->gradient, ip->cost_gradient, ip->program->K * NX * sizeof(double));
    memcpy(ip->gradient_tau, ip->cost_gradient_tau, S * sizeof(double));
    add_rows_transposed(ip->program, ip->row_multipliers, ip->gradient, ip->gradient_tau);
}

/* Compute the Newton direction towards s z = e w = mu, with Mehrotra's corrector where `corrected` is 1: solve
 *
 *     min  1/2 dx'(H + C'W C) dx + (H x + g + C'y)'dx   over the steps dx that keep the gaps closed,
 *
 * where y has -sign (z + dz at C dx = 0) of the inequalities and y + residual / delta of the equations. Then recover
 * the steps of slacks and multipliers. `form_hessian` and `factorize` come before. Nocedal, Wright (2006), section 16.6.
 *
 * In: mu, corrected. Out: row_steps = C dx, the first 2NK of which are the steps of X; tau_step; those of slacks and
 * multipliers; the ratio test. */
static void newton_direction(InteriorPoint *ip, double mu, double corrected, RatioTest *test) {
    const QuadraticProgram *program = ip->program;
    Equations *equations = &ip->equations;
    double delta = 1.0 / ip->max_row_weight;
    form_right_hand_side(ip->hard, 0, mu, corrected);
    form_right_hand_side(ip->soft, 1, mu, corrected);
    memset(ip->row_multipliers, 0, row_count(program) * sizeof(double));
    add_inequality_multipliers(ip->hard, 1.0, ip->row_multipliers);
    add_inequality_multipliers(ip->soft, 1.0, ip->row_multipliers);
    for (int64_t j = 0; j < equations->count; j++)
        ip->row_multipliers[equations->row[j]] +=
            equations->multiplier[j] + equations->residual[j] * ip->max_row_weight;
    compute_gradient(ip);
    int is_dense = program->interval_row_count > 0;
    if (is_dense) dense_backward(&ip->riccati, ip->dense, ip->gradient, ip->gradient_tau, ip->control_gradients);
    else riccati_backward(&ip->riccati, ip->intervals, ip->gradient, ip->gradient_tau, ip->control_gradients);
    solve_schur(ip, ip->gradient_tau, ip->tau_step);
    if (is_dense) dense_forward(&ip->riccati, ip->dense, ip->tau_step, ip->control_gradients, ip->row_steps);
    else riccati_forward(&ip->riccati, ip->intervals, ip->tau_step, ip->control_gradients, ip->row_steps);
    apply_rows(program, ip->tau_step, ip->row_steps);
    *test = (RatioTest){1.0, 1.0, 0.0, 0.0};
    recover_steps(ip->hard, 0, ip->row_steps, delta, test);
    recover_steps(ip->soft, 1, ip->row_steps, delta, test);
    for (int64_t j = 0; j < equations->count; j++) {
        double next_residual = equations->residual[j] + ip->row_steps[equations->row[j]];
        equations->multiplier_step[j] = next_residual * ip->max_row_weight;
    }
}

/* Take a step of the lengths alpha_p (X, tau, slacks, violations) and alpha_d (multipliers); update the largest
 * residual and the complementarity. */
static void take_step(InteriorPoint *ip, double alpha_p, double alpha_d, double *X, double *tau) {
    const int64_t S = ip->program->S;
    Equations *equations = &ip->equations;
    double largest = 0.0;
    ip->complementarity = 0.0;
    step_inequalities(ip->hard, 0, ip->row_steps, alpha_p, alpha_d, &largest, &ip->complementarity);
    step_inequalities(ip->soft, 1, ip->row_steps, alpha_p, alpha_d, &largest, &ip->complementarity);
    for (int64_t j = 0; j < equations->count; j++) {
        equations->residual[j] += alpha_p * ip->row_steps[equations->row[j]];
        equations->multiplier[j] += alpha_d * equations->multiplier_step[j];
        largest = fmax(largest, fabs(equations->residual[j]));
    }
    for (int64_t i = 0; i < ip->program->K * NX; i++) X[i] += alpha_p * ip->row_steps[i];
    for (int c = 0; c < S; c++) tau[c] += alpha_p * ip->tau_step[c];
    ip->primal_residual = largest;
}

/* Return the dual residual, the largest derivative of the Lagrangian by a velocity or a duration, infinite where one is
 * no number. Out: row_multipliers and the program's gap_multipliers, those of the iterate. */
NOINLINE double dual_residual(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    const Equations *equations = &ip->equations;
    double largest = 0.0;
    double sum = 0.0; /* fmax skips what is no number, a sum does not */
    memset(ip->row_multipliers, 0, row_count(program) * sizeof(double));
    for (int64_t j = 0; j < equations->count; j++) ip->row_multipliers[equations->row[j]] = equations->multiplier[j];
    add_inequality_multipliers(ip->hard, 0.0, ip->row_multipliers);
    add_inequality_multipliers(ip->soft, 0.0, ip->row_multipliers);
    compute_gradient(ip);
    compute_reduced_gradient(program, ip->gradient, ip->gradient_tau, ip->reduced_gradient, program->gap_multipliers);
    for (int c = 0; c < S; c++) {
        largest = fmax(largest, fabs(ip->gradient_tau[c]));
        sum += ip->gradient_tau[c];
    }
#pragma omp simd reduction(max : largest) reduction(+ : sum)
    for (int64_t i = 0; i < program->K * N; i++) {
        double size = fabs(ip->reduced_gradient[i]);
        largest = largest > size ? largest : size;
        sum += size;
    }
    return isfinite(sum) ? largest : INFINITY;
}

/* Tell whether the multipliers y prove that no point meets all hard rows: y'(C x - bounds) > 0 at the iterate, by more
 * than any step inside the bounds can change it,
 *
 *     y'(C x - bounds) > 2 sum of |reduced gradient of y'C x| times the longest step of that velocity or duration,
 *
 * with the factor 2 for rounding. Farkas' lemma: Nocedal, Wright (2006), lemma 12.4. */
static int proves_infeasible(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    const Inequalities *ineq = &ip->hard;
    const Equations *equations = &ip->equations;
    double violated = 0.0;
    double reducible = 0.0;
    for (int64_t j = 0; j < ineq->count; j++) violated -= ineq->multiplier[j] * ineq->distance[j];
    for (int64_t j = 0; j < equations->count; j++) violated += equations->multiplier[j] * equations->residual[j];
    if (!(violated > 0.0)) return 0;
    memset(ip->gradient, 0, program->K * NX * sizeof(double));
    memset(ip->gradient_tau, 0, S * sizeof(double));
    /* Soft rows make nothing infeasible and bound no step: their multipliers are left out. */
    memset(ip->row_multipliers, 0, row_count(program) * sizeof(double));
    for (int64_t j = 0; j < equations->count; j++) ip->row_multipliers[equations->row[j]] = equations->multiplier[j];
    add_inequality_multipliers(*ineq, 0.0, ip->row_multipliers);
    add_rows_transposed(program, ip->row_multipliers, ip->gradient, ip->gradient_tau);
    double *unused_multipliers = ip->control_gradients;
    compute_reduced_gradient(program, ip->gradient, ip->gradient_tau, ip->reduced_gradient, unused_multipliers);
    for (int64_t k = 0; k < program->K; k++)
        for (int i = 0; i < N; i++) {
            int64_t row = k * NX + N + i;
            double to_bound = fmax(program->high[row] - program->X[row], program->X[row] - program->low[row]);
            double longest = is_soft(program, row) ? UNBOUNDED_STEP : fmin(to_bound, UNBOUNDED_STEP);
            reducible += longest * fabs(ip->reduced_gradient[k * N + i]);
        }
    for (int c = 0; c < S; c++) reducible += UNBOUNDED_STEP * fabs(ip->gradient_tau[c]);
    return violated > 2.0 * reducible;
}

/* Take memory for `count` doubles from the workspace, aligned, with a vector to spare. */
static double *allocate(double **workspace, int64_t count) {
    double *array = *workspace;
    *workspace += PADDED(count + LANES);
    return array;
}

/* Allocate the arrays of at most `capacity` inequalities. */
static void allocate_inequalities(Inequalities *ineq, int64_t capacity, int soft, double **workspace) {
    ineq->row = (int64_t *)allocate(workspace, capacity);
    ineq->sign = allocate(workspace, capacity);
    ineq->distance = allocate(workspace, capacity);
    ineq->slack = allocate(workspace, capacity);
    ineq->multiplier = allocate(workspace, capacity);
    ineq->slack_step = allocate(workspace, capacity);
    ineq->multiplier_step = allocate(workspace, capacity);
    ineq->inverse_pivot = allocate(workspace, capacity);
    if (!soft) return;
    ineq->violation = allocate(workspace, capacity);
    ineq->violation_multiplier = allocate(workspace, capacity);
    ineq->violation_step = allocate(workspace, capacity);
    ineq->relaxation = allocate(workspace, capacity);
    ineq->relaxation_shift = allocate(workspace, capacity);
}

/* Allocate all arrays of the method in the workspace, a row at most two inequalities. Returns how many doubles they
 * take. */
static int64_t allocate_all(InteriorPoint *ip, const QuadraticProgram *program, double *workspace) {
    const int64_t S = program->S;
    double *begin = workspace;
    int64_t K = program->K;
    int64_t rows = row_count(program);
    int64_t doubles_of_gains = (int64_t)(sizeof(IntervalGains) / sizeof(double));
    Equations *equations = &ip->equations;
    ip->program = program;
    allocate_inequalities(&ip->hard, 2 * rows, 0, &workspace);
    allocate_inequalities(&ip->soft, 2 * rows, 1, &workspace);
    ip->row_weights = allocate(&workspace, rows);
    ip->row_multipliers = allocate(&workspace, rows);
    ip->row_steps = allocate(&workspace, rows);
    equations->residual = allocate(&workspace, rows);
    equations->multiplier = allocate(&workspace, rows);
    equations->multiplier_step = allocate(&workspace, rows);
    equations->row = (int64_t *)allocate(&workspace, rows);
    int64_t interval_rows = program->interval_row_count;
    if (interval_rows) {
        ip->dense = (DenseTableau *)allocate(&workspace, K * (int64_t)(sizeof(DenseTableau) / sizeof(double)));
        ip->dense_y = (vec(*)[Y_VECS])allocate(&workspace, interval_rows * Y_PADDED);
        ip->dense_patterns =
            (Pattern *)allocate(&workspace, interval_rows * (int64_t)(sizeof(Pattern) / sizeof(double)));
        ip->dense_weights = allocate(&workspace, interval_rows);
        ip->tau_by_gaps = allocate(&workspace, interval_rows * S);
    } else {
        ip->intervals = (IntervalGains *)allocate(&workspace, K * doubles_of_gains);
    }
    ip->H_QQ = (vec *)allocate(&workspace, K * N * N_PADDED);
    ip->control_gradients = allocate(&workspace, K * N_PADDED);
    ip->cost_gradient = allocate(&workspace, K * NX);
    ip->gradient = allocate(&workspace, K * NX);
    ip->reduced_gradient = allocate(&workspace, K * N);
    ip->R = allocate(&workspace, K * N);
    ip->H_x_tau = allocate(&workspace, K * NX * S);
    ip->cost_gradient_tau = allocate(&workspace, S);
    ip->gradient_tau = allocate(&workspace, S);
    ip->tau_step = allocate(&workspace, S);
    ip->schur = allocate(&workspace, S * S);
    ip->schur_factor = allocate(&workspace, S * S);
    ip->H_tau_tau = allocate(&workspace, S * S);
    return workspace - begin;
}

/* Tell whether the bounds of a row are so near to each other that it is an equation; soft bounds never are. */
static int is_equation(const QuadraticProgram *program, int64_t row) {
    return !is_soft(program, row) && program->high[row] - program->low[row] <= EQUALITY_WIDTH;
}

/* List the inequalities of all hard or of all soft rows, those of lower bounds before those of upper ones, with their
 * distances at the first iterate, whose rows C x stand in row_steps. */
static void list_inequalities(const InteriorPoint *ip, int soft, Inequalities *ineq) {
    int64_t rows = row_count(ip->program);
    int64_t count = 0;
    for (double sign = 1.0; sign >= -1.0; sign -= 2.0)
        for (int64_t i = 0; i < rows; i++) {
            double bound = sign > 0.0 ? ip->program->low[i] : ip->program->high[i];
            if (!isfinite(bound) || is_equation(ip->program, i) || is_soft(ip->program, i) != soft) continue;
            ineq->row[count] = i;
            ineq->sign[count] = sign;
            ineq->distance[count] = sign * (ip->row_steps[i] - bound);
            count++;
        }
    ineq->count = count;
}

/* List the rows that are equations, each to the middle of its bounds, multipliers 0. */
static void list_equations(const InteriorPoint *ip, Equations *equations) {
    const QuadraticProgram *program = ip->program;
    int64_t rows = row_count(program);
    int64_t count = 0;
    for (int64_t i = 0; i < rows; i++)
        if (is_equation(program, i)) {
            equations->row[count] = i;
            equations->residual[count] = ip->row_steps[i] - (program->low[i] + program->high[i]) / 2;
            equations->multiplier[count] = 0.0;
            equations->multiplier_step[count] = 0.0;
            count++;
        }
    equations->count = count;
}

/* Return the distance between the bounds of the quantity that an inequality bounds. Accelerations and constraints on
 * intervals have a row for each of their bounds, one of them infinite; all other quantities have both in one row. */
static double bound_width(const InteriorPoint *ip, int64_t row) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    int64_t interval_rows = program->K * NX + 2 * S + program->node_row_count;
    int64_t input_rows = interval_rows + 2 * program->interval_row_count;
    int64_t first = row < input_rows ? interval_rows : input_rows;
    int64_t count = row < input_rows ? program->interval_row_count : program->K * N;
    int64_t low = row;
    int64_t high = row;
    if (row >= first + count) low -= count;
    else if (row >= first) high += count;
    return program->high[high] - program->low[low] + (ip->row_steps[low] - ip->row_steps[high]);
}

/* Choose the first slacks and multipliers. With the largest violation v of a hard row,
 *
 *     push = max(bound_push, v),   mu = initial_barrier push / bound_push,
 *     hard    s = max(d, min(push, width / 4)),   z = mu / max(s, push),
 *     soft    e = max(bound_push - d, mu / penalty),   s = d + e,   z = min(mu / s, penalty / 2),   w = penalty - z.
 *
 * A slack is so at most a quarter of the way to the other bound, unless the iterate is farther from its own. Between bounds
 * that are near to each other a multiplier mu / s would be so large that it falls last, when s has long vanished. */
static void initialize_inequalities(InteriorPoint *ip) {
    const QuadraticProgram *program = ip->program;
    const Equations *equations = &ip->equations;
    Inequalities *ineq = &ip->hard;
    double push = program->bound_push;
    for (int64_t j = 0; j < ineq->count; j++) push = fmax(push, -ineq->distance[j]);
    for (int64_t j = 0; j < equations->count; j++) push = fmax(push, fabs(equations->residual[j]));
    double mu = program->initial_barrier * (push / program->bound_push);
    for (int64_t j = 0; j < ineq->count; j++) {
        double width = bound_width(ip, ineq->row[j]);
        ineq->slack[j] = fmax(ineq->distance[j], fmin(push, width / 4));
        ineq->multiplier[j] = mu / fmax(ineq->slack[j], push);
        ineq->slack_step[j] = 0.0;
        ineq->multiplier_step[j] = 0.0;
    }
    ineq = &ip->soft;
    for (int64_t j = 0; j < ineq->count; j++) {
        double penalty = program->penalty[ineq->row[j]];
        ineq->violation[j] = fmax(program->bound_push - ineq->distance[j], mu / penalty);
        ineq->slack[j] = ineq->distance[j] + ineq->violation[j];
        ineq->multiplier[j] = fmin(mu / ineq->slack[j], penalty / 2);
        ineq->violation_multiplier[j] = penalty - ineq->multiplier[j];
        ineq->slack_step[j] = 0.0;
        ineq->multiplier_step[j] = 0.0;
        ineq->violation_step[j] = 0.0;
    }
}

/* Copy the upper triangles of the Hessian by the positions, (K, N, N), to full matrices, padded. */
static void fill_positions(InteriorPoint *ip) {
    const QuadraticProgram *program = ip->program;
    memset(ip->H_QQ, 0, program->K * N * N_PADDED * sizeof(double));
    for (int64_t k = 0; k < program->K; k++)
        for (int i = 0; i < N; i++)
            for (int j = i; j < N; j++) {
                double value = program->H_QQ[(k * N + i) * N + j];
                scalars(ip->H_QQ + (k * N + j) * N_VECS)[i] = value;
                scalars(ip->H_QQ + (k * N + i) * N_VECS)[j] = value;
            }
}

/* Write the constraints on intervals as rows of y, but for what they have by tau themselves. */
static void reduce_interval_rows(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    for (int64_t i = 0; i < program->interval_row_count; i++) {
        int64_t k = program->interval_row[i];
        double a = -program->gap_velocity[2 * k];
        double b = -program->gap_velocity[2 * k + 1];
        const double *c = program->interval_jacobian + i * INTERVAL_ROW;
        reduce_interval_row(S, c, a, b, program->gap_tau + k * N * S, ip->dense_y[i]);
        memcpy(ip->tau_by_gaps + i * S, scalars(ip->dense_y[i]) + Y_Q_COLUMN + N, S * sizeof(double));
        ip->dense_patterns[i] = pattern_of(S, ip->dense_y[i]);
    }
}

/* Set the first iterate: v = 0 and tau = 0, the positions that close the gaps, Q_k+1 = Q_k - gap_k; its inequalities,
 * equations, slacks, multipliers, residuals and complementarity. */
static void initialize(InteriorPoint *ip) {
    const int64_t S = ip->program->S;
    const QuadraticProgram *program = ip->program;
    double Q[N] = {0};
    ip->max_row_weight = MAX_ROW_WEIGHT;
    ip->riccati = (RiccatiData){
        .K = program->K,
        .S = program->S,
        .H_QQ = ip->H_QQ,
        .state_weights = ip->row_weights,
        .H_x_tau = program->has_input_rows ? ip->H_x_tau : program->H_x_tau,
        .H_tau_tau = ip->H_tau_tau,
        .R = ip->R,
        .gap_velocity = program->gap_velocity,
        .gap_tau = program->gap_tau,
        .node_row_count = program->node_row_count,
        .row_node = program->row_node,
        .row_jacobian = program->row_jacobian,
    };
    ip->dense_rows = (IntervalRows){
        .count = program->interval_row_count,
        .interval = program->interval_row,
        .weights = ip->dense_weights,
        .y = (const vec(*)[Y_VECS])ip->dense_y,
        .patterns = ip->dense_patterns,
    };
    reduce_interval_rows(ip);
    fill_positions(ip);
    memset(program->X, 0, program->K * NX * sizeof(double));
    memset(program->tau, 0, S * sizeof(double));
    for (int64_t k = 0; k < program->K; k++)
        for (int i = 0; i < N; i++) {
            Q[i] -= program->gaps[k * N + i];
            program->X[k * NX + i] = Q[i];
        }
    memcpy(ip->row_steps, program->X, program->K * NX * sizeof(double));
    apply_rows(program, program->tau, ip->row_steps);
    list_inequalities(ip, 1, &ip->soft);
    list_inequalities(ip, 0, &ip->hard);
    list_equations(ip, &ip->equations);
    initialize_inequalities(ip);
    memset(ip->tau_step, 0, S * sizeof(double));
    take_step(ip, 0.0, 0.0, program->X, program->tau);
}

/* Factorize the Newton equations, by the controls and then by the durations. Returns 0 where the Hessian H + C'W C is not
 * positive definite on the steps that keep the gaps closed. */
static int factorize(InteriorPoint *ip) {
    int is_dense = ip->program->interval_row_count > 0;
    int is_definite = is_dense ? dense_factorize(&ip->riccati, &ip->dense_rows, ip->dense, ip->schur)
                               : riccati_factorize(&ip->riccati, ip->intervals, ip->schur);
    return is_definite && factorize_schur(ip);
}

/* Factorize the Newton equations, with smaller largest weights of rows, to a tenth each time, while the Hessian is not
 * positive definite: rounding may have made it so. Returns 0 where none works, since it has negative curvature. */
static int factorize_regularized(InteriorPoint *ip) {
    for (; ip->max_row_weight > MIN_ROW_WEIGHT; ip->max_row_weight /= 10.0) {
        form_hessian(ip);
        if (factorize(ip)) return 1;
    }
    return 0;
}

/* Return the complementarity after a step of the lengths alpha_p and alpha_d of an affine direction:
 *
 *     sum of (s + alpha_p ds) (z + alpha_d dz)
 *         = (1 - alpha_d) sum of s z + (alpha_p - alpha_d) sum of z ds + alpha_p alpha_d sum of ds dz,
 *
 * since s dz = -s z - z ds; e and w alike. */
static double affine_complementarity(double complementarity, RatioTest test, double alpha_p, double alpha_d) {
    return (1.0 - alpha_d) * complementarity + (alpha_p - alpha_d) * test.slack_change +
           alpha_p * alpha_d * test.step_product;
}

/* Return the length of a step, the fraction to the boundary: min(1, 0.995 / largest relative decrease). */
static double step_length(double largest_decrease) {
    return largest_decrease > 1.0 ? FRACTION_TO_BOUNDARY / largest_decrease : 1.0;
}

/* Take a step of Mehrotra's predictor-corrector method. The affine direction (mu = 0) says how far the complementarity
 * can decrease, and the centering parameter
 *
 *     sigma = (mu_affine / mu)^3,   mu = complementarity / number of products s z and e w,
 *
 * where the corrected direction steers to, sigma mu, no less than the tolerance needs. Steps have lengths of their own
 * for primal and dual, or one length where `equal_lengths`. `factorize_regularized` comes before. Returns 0 where the
 * step gets nowhere. Nocedal, Wright (2006), algorithm 16.4. */
static int predictor_corrector_step(InteriorPoint *ip, double product_count, int equal_lengths) {
    const QuadraticProgram *program = ip->program;
    RatioTest test;
    newton_direction(ip, 0.0, 0.0, &test);
    double affine = affine_complementarity(ip->complementarity, test, 1.0 / test.primal, 1.0 / test.dual);
    double ratio = ip->complementarity > 0.0 ? affine / ip->complementarity : 0.0;
    double mu = ip->complementarity / product_count;
    double final_mu = FINAL_CENTERING * program->tolerance / product_count;
    double target_mu = fmax(ratio * ratio * ratio * mu, final_mu);
    newton_direction(ip, target_mu, 1.0, &test);
    double alpha_p = step_length(test.primal);
    double alpha_d = step_length(test.dual);
    if (equal_lengths) {
        alpha_p = fmin(alpha_p, alpha_d);
        alpha_d = alpha_p;
    }
    take_step(ip, alpha_p, alpha_d, program->X, program->tau);
    return alpha_p > MIN_STEP_LENGTH || alpha_d > MIN_STEP_LENGTH;
}

/* Return how many doubles the workspace of a program takes; of the program, sizes and flags are read alone. */
int64_t SIZED(psmpc_qp_workspace_size)(const QuadraticProgram *program) {
    InteriorPoint ip;
    return allocate_all(&ip, program, NULL);
}

/* Solve a program. Writes X, tau, gap_multipliers, row_multipliers and report; returns SOLVED, INFEASIBLE, NOT_CONVEX or
 * FAILED.
 *
 * It is solved where primal residual, dual residual and complementarity are at most `tolerance`, or at most
 * `acceptable_tolerance` where half of the iterations or the digits have run out: programs whose digits do not suffice
 * for `tolerance` come near it and move away again.
 *
 * Every iteration factorizes H + C'W C. Near the solution the weights W are large of rows that are active there, and
 * vanish of others: a program that is solved has no negative curvature that these rows leave room for, so that its
 * solution is a minimum. Nocedal, Wright (2006), theorem 12.6. Without inequalities that holds where it is convex. */
int64_t SIZED(psmpc_qp_solve)(const QuadraticProgram *program) {
    InteriorPoint ip;
    allocate_all(&ip, program, program->workspace);
    initialize(&ip);
    double product_count = fmax((double)(ip.hard.count + 2 * ip.soft.count), 1.0);
    double previous = INFINITY; /* larger one of dual residual and complementarity, an iteration before */
    int equal_lengths = 0;
    for (int64_t iteration = 0;; iteration++) {
        compute_cost_gradient(&ip, program->X, program->tau);
        double primal = ip.primal_residual;
        double dual = dual_residual(&ip);
        double dual_or_complementarity = fmax(dual, ip.complementarity);
        double largest = fmax(fmax(primal, dual), ip.complementarity);
        program->report[0] = (double)iteration;
        program->report[1] = primal;
        program->report[2] = dual;
        program->report[3] = ip.complementarity;
        memcpy(program->row_multipliers, ip.row_multipliers, row_count(program) * sizeof(double));
        if (!isfinite(largest)) return FAILED;
        int is_late = 2 * iteration >= program->max_iterations;
        double sufficient = is_late ? program->acceptable_tolerance : program->tolerance;
        if (iteration > 0 && largest <= sufficient) return SOLVED; /* at the first iterate nothing is factorized yet */
        if (primal > program->tolerance && proves_infeasible(&ip)) return INFEASIBLE;
        /* Two lengths may increase the dual residual; equal lengths decrease every residual. */
        if (primal <= program->acceptable_tolerance && dual_or_complementarity > previous) equal_lengths = 1;
        previous = dual_or_complementarity;
        int is_last = iteration == program->max_iterations;
        if (!is_last && !factorize_regularized(&ip)) return NOT_CONVEX;
        if (is_last || !predictor_corrector_step(&ip, product_count, equal_lengths))
            return largest <= program->acceptable_tolerance ? SOLVED : FAILED;
    }
}
