// 0..1 in equal parts of 1/65535, rounded to nearest here: OpenGL leaves open how a store rounds.
void store_sum(ivec2 texel, STATE from, STATE change) {
    imageStore(r_out, texel, TO_FOUR(roundEven((from + change) * 65535.0) / 65535.0));
}
