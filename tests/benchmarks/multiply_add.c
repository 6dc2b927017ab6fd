/* The loop of docs/alternatives.multiply_add in C: sums += weight x factor over a run of consecutive numbers an item. */
void multiply_add(double *restrict sums, const double *restrict weights, const double *restrict factors,
                  long room, long size, long items) {
    for (long i = 0; i < items; i++) {
        double *first = sums + (long)(room * ((double)i / items));
        for (long k = 0; k < size; k++) first[k] += weights[k] * factors[i];
    }
}
