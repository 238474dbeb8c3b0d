// float32.
void store_sum(ivec2 texel, STATE from, STATE change) {
    imageStore(r_out, texel, TO_FOUR(from + change));
}
