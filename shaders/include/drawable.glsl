// Which samples of the G-buffer belong to the drawable at hand. A dispatch covers its rectangle on the screen.
uniform sampler2D position_w; // w: the drawable's number
uniform ivec2 corner;
uniform float drawable;

bool find_sample(out ivec2 at, out vec3 p_w) {
    at = corner + ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, textureSize(position_w, 0)))) return false;
    vec4 p = texelFetch(position_w, at, 0);
    p_w = p.xyz;
    return p.w == drawable;
}
