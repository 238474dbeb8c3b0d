// Calls at_texel(), which stands above, for every texel of r_out, ROWS of them an invocation. On a CPU rasterizer to
// fetch a uniform costs as much as a dozen sums, and once it is fetched it serves them all.
layout(local_size_x = 64) in; // a row of texels: an eighth faster than a square on a CPU rasterizer

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy), last = imageSize(r_out) - 1;
    if (texel.x > last.x) return;
    // Beyond the last row it comes once more, to the same end: a branch in the loop would fetch the uniforms anew.
    for (int i = 0; i < ROWS; ++i) at_texel(ivec2(texel.x, min(texel.y * ROWS + i, last.y)));
}
