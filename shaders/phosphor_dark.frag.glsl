#version 430
// One step without light: r' = keep r - lose r, with both factors computed in float64 on the host.
uniform sampler2D r_in;
uniform vec4 keep;
uniform vec4 lose;
out vec4 r_out;

void main() {
    vec4 r = texelFetch(r_in, ivec2(gl_FragCoord.xy), 0);
    r_out = keep * r - lose * r;
}
