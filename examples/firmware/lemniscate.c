/* A flight of 15 s without Rust: an exported vehicle, controller and reference in closed loop.
 *
 * Made from modules of one precision, `float` unless -DREAL=double:
 *
 *     cc -std=c99 -O2 lemniscate.c hummingbird.c hummingbird_cascade.c lemniscate_reference.c -lm -o lemniscate
 *     ./lemniscate flight.csv
 *
 * It prints the root mean square of the distance to the reference, and writes the flight where a file is named. The reference is
 * exported under the name `lemniscate_reference`. */
#include "hummingbird.h"
#include "hummingbird_cascade.h"
#include "lemniscate_reference.h"

#include <math.h>
#include <stdio.h>

#ifndef REAL
#define REAL float
#endif

#define SECONDS 15

/* rad/s: four rotors that turn so carry the weight, nearly */
static const REAL START_SPEED = (REAL)453.25;

/* at rest and level where the reference begins, rotors turning */
static void begin(REAL state[HUMMINGBIRD_STATE_SIZE])
{
    REAL time[1] = {0}, target[LEMNISCATE_REFERENCE_TARGET_SIZE];
    lemniscate_reference_target(time, target);
    for (int k = 0; k < HUMMINGBIRD_STATE_SIZE; k++) state[k] = 0;
    for (int k = 0; k < 3; k++) state[k] = target[k];
    state[HUMMINGBIRD_STATE_ATTITUDE_W] = 1;
    for (int k = HUMMINGBIRD_STATE_ROTOR_0_SPEED; k <= HUMMINGBIRD_STATE_ROTOR_3_SPEED; k++) state[k] = START_SPEED;
}

static void write_row(FILE *file, const REAL *row, int n, char end)
{
    for (int k = 0; k < n; k++) fprintf(file, "%.17g%c", (double)row[k], k + 1 < n ? ',' : end);
}

int main(int n, char **arguments)
{
    FILE *file = n > 1 ? fopen(arguments[1], "w") : NULL;
    if (n > 1 && file == NULL) {
        fprintf(stderr, "'%s' cannot be written\n", arguments[1]);
        return 1;
    }
    const int ticks = (int)(SECONDS / HUMMINGBIRD_PERIOD + (REAL)0.5);
    hummingbird_cascade_memory memory;
    hummingbird_cascade_reset(&memory);
    REAL state[HUMMINGBIRD_STATE_SIZE], target[LEMNISCATE_REFERENCE_TARGET_SIZE], input[HUMMINGBIRD_INPUT_SIZE];
    REAL squares = 0;
    begin(state);
    for (int tick = 0; tick < ticks; tick++) {
        const REAL time[1] = {(REAL)tick * HUMMINGBIRD_PERIOD};
        lemniscate_reference_target(time, target);
        hummingbird_cascade_tick(&memory, state, target, input);
        for (int k = 0; k < 3; k++) squares += (state[k] - target[k]) * (state[k] - target[k]);
        if (file != NULL) {
            write_row(file, time, 1, ',');
            write_row(file, state, HUMMINGBIRD_STATE_SIZE, ',');
            write_row(file, target, 3, ',');
            write_row(file, input, HUMMINGBIRD_INPUT_SIZE, '\n');
        }
        hummingbird_step(state, input, state);
    }
    if (file != NULL) fclose(file);
    printf("root mean square of the distance: %.4f m over %d ticks\n", sqrt((double)squares / ticks), ticks);
    printf("last state: ");
    write_row(stdout, state, HUMMINGBIRD_STATE_SIZE, '\n');
    return squares / (REAL)ticks < 1 ? 0 : 1;
}
