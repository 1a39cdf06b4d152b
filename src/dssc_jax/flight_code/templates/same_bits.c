static bits bits_of(real x)
{
    bits same;
    memcpy(&same, &x, sizeof same);
    return same;
}

static bool same(real a, real b)
{
    return bits_of(a) == bits_of(b) || (isnan(a) && isnan(b)); /* the bits of a NaN are the processor's own */
}
