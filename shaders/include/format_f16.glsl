// float16, rounded to nearest here: OpenGL leaves open how a store rounds.
void store_sum(ivec2 texel, STATE from, STATE change) {
    STATE r = from + change;
    // The last place of a half in r's binade: 10 bits below, and 2^-24 for the smallest.
    STATE_UINT binade = max(floatBitsToUint(r) & 0x7f800000u, STATE_UINT(113u << 23));
    STATE ulp = uintBitsToFloat(binade - (10u << 23));
    imageStore(r_out, texel, TO_FOUR(roundEven(r / ulp) * ulp));
}
