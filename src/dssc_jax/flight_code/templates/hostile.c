static uint64_t seed = 88172645463325252u;

static uint64_t random_bits(void) /* xorshift, G. Marsaglia (2003) */
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

static real hostile_number(void)
{
    const real few[] = {0,        -(real)0, 1,        -1,       SMALLEST,          -SMALLEST, SMALLEST / 4, LARGEST,
                        -LARGEST, EPSILON,  INFINITY, -INFINITY, (real)NAN, -(real)NAN, (real)1e9,   (real)1e-9};
    const uint64_t choice = random_bits();
    if (choice % 4 == 0) {
        return few[choice / 4 % (sizeof few / sizeof few[0])];
    }
    if (choice % 4 == 1) {
        const bits any = (bits)random_bits();
        real number;
        memcpy(&number, &any, sizeof number);
        return number;
    }
    return (real)((double)(random_bits() >> 11) / 4503599627370496.0 - 1.0);
}
