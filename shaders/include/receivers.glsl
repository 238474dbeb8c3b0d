// What a pixel's glow falls on: the sample in its middle, in the coordinates of the cells.
uniform sampler2D position_w; // w: the drawable's number
uniform sampler2D normal_w;
uniform vec4 to_cells; // centre of the scene, and 1 / radius

ivec2 picture_size() {
    return textureSize(position_w, 0) / SUPERSAMPLING;
}

bool find_receiver(ivec2 pixel, out vec3 p, out vec3 n) {
    ivec2 at = pixel * SUPERSAMPLING + SUPERSAMPLING / 2;
    vec4 seen = texelFetch(position_w, at, 0);
    p = (seen.xyz - to_cells.xyz) * to_cells.w;
    n = normalize(texelFetch(normal_w, at, 0).xyz);
    return seen.w > 0.0;
}
