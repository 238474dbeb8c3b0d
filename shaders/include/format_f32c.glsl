// float32 with what its rounding lost in a second texture (Knuth, The Art of Computer Programming 2, 4.2.2, th. B).
layout(IMAGE_FORMAT, binding = 1) writeonly uniform image2D low_out;

void store_sum(ivec2 texel, STATE from, STATE change) {
    // `precise`, or a compiler that takes these for real numbers finds that nothing is lost.
    precise STATE sum = from + change;
    precise STATE added = sum - from;
    precise STATE lost = (from - (sum - added)) + (change - added);
    // What was kept back may put the sum outside [0, 1] by half a unit in the last place.
    STATE inside = clamp(sum, 0.0, 1.0);
    imageStore(r_out, texel, TO_FOUR(inside));
    imageStore(low_out, texel, TO_FOUR(clamp(lost, -inside, 1.0 - inside)));
}
