/* Straight-line functions as tapes: lists of instructions that are carried out for many rows at once.
 *
 * A tape is data, so a new function compiles nothing; the cost of looking at an instruction is shared by the rows of a
 * block and, where several instructions of one kind follow each other, by those. `psmpc_tape_arrange` orders them so.
 *
 * Values stand in slots: those of the arguments, of the constants, then of results of instructions; a slot has one
 * value for each row of a block. Python's numbers of the operations, CasADi's, stand before this. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LANES 8  /* values of a vector */
#define VECTORS 2 /* vectors of a slot */
#define BLOCK (LANES * VECTORS) /* rows of a block */
typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t mask __attribute__((vector_size(8 * LANES)));

#define INLINE static inline __attribute__((always_inline))

/* One instruction as CasADi has it: it reads registers and writes one. */
typedef struct {
    int32_t operation;
    int32_t result; /* a register; of OP_OUTPUT, the index of the entry among those of all results */
    int32_t left;   /* a register; of OP_INPUT and OP_CONST, the slot */
    int32_t right;  /* a register, that of left again where there is one operand */
} Instruction;

/* `count` instructions of the same operation, one after the other. */
typedef struct {
    int32_t operation;
    int32_t count;
} Run;

/* The slots of an instruction. */
typedef struct {
    int32_t result;
    int32_t left;
    int32_t right;
} Operands;

typedef struct {
    int64_t run_count;
    int64_t argument_count;
    int64_t result_count;
    const Run *runs;
    const Operands *operands;
    const int64_t *argument_sizes;
    const int64_t *result_sizes;
    const int32_t *result_slots;    /* of the entries of all results, one after the other */
    const double *const *arguments; /* arrays (rows, size) */
    double *const *results;         /* arrays (rows, size) */
    vec *slots;                     /* (slots, VECTORS); those of the constants are filled */
} TapeProgram;

INLINE vec choose(mask where, vec yes, vec no) { return (vec)((where & (mask)yes) | (~where & (mask)no)); }

INLINE vec everywhere(double value) {
    vec all;
    for (int lane = 0; lane < LANES; lane++) all[lane] = value;
    return all;
}

INLINE vec truth(mask where) { return choose(where, everywhere(1.0), everywhere(0.0)); }

INLINE vec magnitude(vec a) {
    const mask sign = (mask)everywhere(-0.0);
    return (vec)((mask)a & ~sign);
}

/* The next `count` instructions: an expression of vectors a and b, or one of numbers a and b. */
#define EACH_VECTOR(OPERATION, EXPRESSION)                            \
    case OPERATION:                                                   \
        for (; at < end; at++)                                        \
            for (int k = 0; k < vectors; k++) {                       \
                const vec a = slots[at->left * VECTORS + k];          \
                const vec b = slots[at->right * VECTORS + k];         \
                (void)b;                                              \
                slots[at->result * VECTORS + k] = (EXPRESSION);       \
            }                                                         \
        break;
#define EACH_NUMBER(OPERATION, EXPRESSION)                            \
    case OPERATION:                                                   \
        for (; at < end; at++)                                        \
            for (int k = 0; k < vectors * LANES; k++) {               \
                const double a = numbers[at->left * BLOCK + k];       \
                const double b = numbers[at->right * BLOCK + k];      \
                (void)b;                                              \
                numbers[at->result * BLOCK + k] = (EXPRESSION);       \
            }                                                         \
        break;

/* Carry out the instructions for the first vectors of each slot. */
INLINE void carry_out(const TapeProgram *tape, const int vectors) {
    vec *slots = tape->slots;
    double *numbers = (double *)tape->slots;
    const Operands *at = tape->operands;
    for (int64_t r = 0; r < tape->run_count; r++) {
        const Operands *end = at + tape->runs[r].count;
        switch (tape->runs[r].operation) {
            EACH_VECTOR(OP_ADD, a + b)
            EACH_VECTOR(OP_SUB, a - b)
            EACH_VECTOR(OP_MUL, a * b)
            EACH_VECTOR(OP_DIV, a / b)
            EACH_VECTOR(OP_NEG, -a)
            EACH_VECTOR(OP_TWICE, a + a)
            EACH_VECTOR(OP_SQ, a * a)
            EACH_VECTOR(OP_INV, everywhere(1.0) / a)
            EACH_VECTOR(OP_FABS, magnitude(a))
            EACH_VECTOR(OP_FMAX, choose((a < b) | (a != a), b, a))
            EACH_VECTOR(OP_FMIN, choose((a > b) | (a != a), b, a))
            EACH_VECTOR(OP_LT, truth(a < b))
            EACH_VECTOR(OP_LE, truth(a <= b))
            EACH_VECTOR(OP_EQ, truth(a == b))
            EACH_VECTOR(OP_NE, truth(a != b))
            EACH_VECTOR(OP_NOT, truth(a == everywhere(0.0)))
            EACH_VECTOR(OP_AND, truth((a != everywhere(0.0)) & (b != everywhere(0.0))))
            EACH_VECTOR(OP_OR, truth((a != everywhere(0.0)) | (b != everywhere(0.0))))
            EACH_VECTOR(OP_IF_ELSE_ZERO, choose(a != everywhere(0.0), b, everywhere(0.0)))
            EACH_VECTOR(OP_SIGN, choose(a < everywhere(0.0), everywhere(-1.0), choose(a > everywhere(0.0), everywhere(1.0), a)))
            EACH_NUMBER(OP_SQRT, sqrt(a))
            EACH_NUMBER(OP_SIN, sin(a))
            EACH_NUMBER(OP_COS, cos(a))
            EACH_NUMBER(OP_TAN, tan(a))
            EACH_NUMBER(OP_ASIN, asin(a))
            EACH_NUMBER(OP_ACOS, acos(a))
            EACH_NUMBER(OP_ATAN, atan(a))
            EACH_NUMBER(OP_ATAN2, atan2(a, b))
            EACH_NUMBER(OP_SINH, sinh(a))
            EACH_NUMBER(OP_COSH, cosh(a))
            EACH_NUMBER(OP_TANH, tanh(a))
            EACH_NUMBER(OP_ASINH, asinh(a))
            EACH_NUMBER(OP_ACOSH, acosh(a))
            EACH_NUMBER(OP_ATANH, atanh(a))
            EACH_NUMBER(OP_EXP, exp(a))
            EACH_NUMBER(OP_EXPM1, expm1(a))
            EACH_NUMBER(OP_LOG, log(a))
            EACH_NUMBER(OP_LOG1P, log1p(a))
            EACH_NUMBER(OP_POW, pow(a, b))
            EACH_NUMBER(OP_CONSTPOW, pow(a, b))
            EACH_NUMBER(OP_HYPOT, hypot(a, b))
            EACH_NUMBER(OP_ERF, erf(a))
            EACH_NUMBER(OP_FLOOR, floor(a))
            EACH_NUMBER(OP_CEIL, ceil(a))
            EACH_NUMBER(OP_FMOD, fmod(a, b))
            EACH_NUMBER(OP_COPYSIGN, copysign(a, b))
        }
    }
}

/* Separate functions, so that each is compiled for its number of vectors. */
static __attribute__((noinline)) void carry_out_half(const TapeProgram *tape) { carry_out(tape, 1); }
static __attribute__((noinline)) void carry_out_whole(const TapeProgram *tape) { carry_out(tape, VECTORS); }

/* Evaluate a tape at rows of its arguments. */
void psmpc_tape_run(const TapeProgram *tape, int64_t rows) {
    double *numbers = (double *)tape->slots;
    for (int64_t first = 0; first < rows; first += BLOCK) {
        const int64_t here = rows - first < BLOCK ? rows - first : BLOCK;
        double *slot = numbers;
        for (int64_t i = 0; i < tape->argument_count; i++) {
            const int64_t size = tape->argument_sizes[i];
            const double *argument = tape->arguments[i] + first * size;
            for (int64_t j = 0; j < size; j++, slot += BLOCK)
                for (int row = 0; row < BLOCK; row++) /* rows after the last repeat it: they fill the vectors */
                    slot[row] = argument[(row < here ? row : here - 1) * size + j];
        }
        if (here <= LANES)
            carry_out_half(tape);
        else
            carry_out_whole(tape);
        const int32_t *from = tape->result_slots;
        for (int64_t i = 0; i < tape->result_count; i++) {
            const int64_t size = tape->result_sizes[i];
            double *result = tape->results[i] + first * size;
            for (int64_t row = 0; row < here; row++)
                for (int64_t j = 0; j < size; j++) result[row * size + j] = numbers[from[j] * (int64_t)BLOCK + row];
            from += size;
        }
    }
}

#define OPERATIONS 256 /* more than CasADi has */
#define WINDOW 5000    /* instructions that are ordered together: values live longer, and slots are more, in longer ones */

/* Instructions of a window that wait for nothing, by operation: lists, first come, first served. */
typedef struct {
    int32_t first[OPERATIONS];
    int32_t last[OPERATIONS];
    int32_t count[OPERATIONS];
} Ready;

static void make_ready(Ready *ready, int32_t *next, int32_t instruction, int32_t operation) {
    next[instruction] = -1;
    if (ready->count[operation]++)
        next[ready->last[operation]] = instruction;
    else
        ready->first[operation] = instruction;
    ready->last[operation] = instruction;
}

static int32_t take(Ready *ready, const int32_t *next, int32_t operation) {
    const int32_t taken = ready->first[operation];
    ready->first[operation] = next[taken];
    ready->count[operation]--;
    return taken;
}

/* Order the instructions [begin, end) so that those of one operation follow each other: always the operation of which
 * most are ready, until none is left. `left` and `right` are values: those below `given` need no instruction, the others
 * are given + the instruction. */
static void order_window(int32_t begin, int32_t end, const int32_t *operation, const int32_t *left, const int32_t *right,
                         int32_t given, int32_t *waits, int32_t *users, int32_t *next_user, int32_t *next,
                         int32_t *order) {
    Ready ready;
    memset(&ready, 0, sizeof ready);
    for (int32_t i = begin; i < end; i++) {
        users[i] = -1;
        waits[i] = 0;
        const int32_t read[2] = {left[i] - given, right[i] - given};
        for (int side = 0; side < 2; side++)
            if (read[side] >= begin && !(side && read[1] == read[0])) {
                next_user[2 * i + side] = users[read[side]];
                users[read[side]] = 2 * i + side;
                waits[i]++;
            }
        if (!waits[i]) make_ready(&ready, next, i, operation[i]);
    }
    for (int32_t place = begin; place < end;) {
        int32_t most = 0;
        for (int32_t j = 1; j < OPERATIONS; j++)
            if (ready.count[j] > ready.count[most]) most = j;
        while (ready.count[most]) {
            const int32_t taken = take(&ready, next, most);
            order[place++] = taken;
            for (int32_t user = users[taken]; user >= 0; user = next_user[user])
                if (!--waits[user / 2]) make_ready(&ready, next, user / 2, operation[user / 2]);
        }
    }
}

/* Make a tape of instructions.
 *
 * Arguments: `given`, the number of slots of arguments and constants; `registers`, of what the instructions use.
 * Written: `runs` and `operands`, with room for `count` of each, `result_slots`, and the numbers of runs and of slots.
 * Returns 0, or -1 where there is no memory. */
int64_t psmpc_tape_arrange(const Instruction *instructions, int64_t count, int64_t given, int64_t registers, Run *runs,
                           Operands *operands, int32_t *result_slots, int64_t *run_count, int64_t *slot_count) {
    const size_t values = (size_t)(given + count);
    int32_t *memory = malloc((11 * (size_t)count + 2 * values + (size_t)registers + 1) * sizeof *memory);
    if (!memory) return -1;
    int32_t *operation = memory, *left = operation + count, *right = left + count, *order = right + count;
    int32_t *waits = order + count, *users = waits + count, *next_user = users + count, *next = next_user + 2 * count;
    int32_t *spare = next + count, *last_use = spare + 2 * count, *slot = last_use + values, *in_register = slot + values;

    /* Which value each instruction reads, in place of which register. */
    int32_t made = 0;
    for (int64_t i = 0; i < count; i++) {
        const Instruction *each = &instructions[i];
        if (each->operation == OP_INPUT || each->operation == OP_CONST)
            in_register[each->result] = each->left;
        else if (each->operation == OP_ASSIGN)
            in_register[each->result] = in_register[each->left];
        else if (each->operation == OP_OUTPUT)
            result_slots[each->result] = in_register[each->left]; /* the value; its slot is known at the end */
        else {
            operation[made] = each->operation;
            left[made] = in_register[each->left];
            right[made] = in_register[each->right];
            in_register[each->result] = (int32_t)given + made++;
        }
    }
    for (int32_t begin = 0; begin < made; begin += WINDOW)
        order_window(begin, begin + WINDOW < made ? begin + WINDOW : made, operation, left, right, (int32_t)given, waits,
                     users, next_user, next, order);

    /* A slot is free again after the last instruction that reads it. */
    for (size_t value = 0; value < values; value++) last_use[value] = -1;
    for (int32_t place = 0; place < made; place++)
        last_use[left[order[place]]] = last_use[right[order[place]]] = place;
    int64_t outputs = 0;
    for (int64_t i = 0; i < count; i++)
        if (instructions[i].operation == OP_OUTPUT) last_use[result_slots[outputs++]] = made;
    for (int64_t value = 0; value < given; value++) {
        slot[value] = (int32_t)value;
        last_use[value] = made;
    }
    int32_t top = (int32_t)given, spares = 0;
    *run_count = 0;
    for (int32_t place = 0; place < made; place++) {
        const int32_t i = order[place], a = left[i], b = right[i], result = (int32_t)given + i;
        if (last_use[a] == place) spare[spares++] = slot[a];
        if (b != a && last_use[b] == place) spare[spares++] = slot[b];
        slot[result] = spares ? spare[--spares] : top++;
        if (last_use[result] < 0) spare[spares++] = slot[result];
        operands[place] = (Operands){slot[result], slot[a], slot[b]};
        if (*run_count && runs[*run_count - 1].operation == operation[i])
            runs[*run_count - 1].count++;
        else
            runs[(*run_count)++] = (Run){operation[i], 1};
    }
    for (int64_t i = 0; i < outputs; i++) result_slots[i] = slot[result_slots[i]];
    *slot_count = top;
    free(memory);
    return 0;
}
