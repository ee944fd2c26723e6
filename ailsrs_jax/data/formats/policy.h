/* A policy for {{ env_id }}, written by ailsrs_jax.

   policy_act reads {{ sizes[0] }} observations and writes {{ sizes[-1] }} actions. A stochastic
   policy's action is the mean. */
#ifndef AILSRS_POLICY_H
#define AILSRS_POLICY_H

#include <math.h>

#define POLICY_NUM_OBSERVATIONS {{ sizes[0] }}
#define POLICY_NUM_ACTIONS {{ sizes[-1] }}

{% for name, numbers in constants.items() %}
static const double policy_{{ name }}[{{ numbers | length }}] = { {{- numbers | join(", ") -}} };
{% endfor %}

/* y = W x + b, of tanh(x) if it is the output of an earlier layer */
static void policy_layer(const double *weights, const double *biases, int num_in, int num_out,
                         int first, const double *x, double *y) {
    for (int i = 0; i < num_out; i++) {
        y[i] = biases[i];
        for (int j = 0; j < num_in; j++)
            y[i] += weights[i * num_in + j] * (first ? x[j] : tanh(x[j]));
    }
}

static void policy_act(const double *observation, double *action) {
    double x[{{ sizes | max }}], y[{{ sizes | max }}];
    for (int i = 0; i < POLICY_NUM_OBSERVATIONS; i++)
        x[i] = (observation[i] - policy_mean[i]) / policy_std[i];
{% for num_out in sizes[1:] %}
    policy_layer(policy_weights_{{ loop.index0 }}, policy_biases_{{ loop.index0 }}, {{ sizes[loop.index0] }}, {{ num_out }}, {{ loop.first | int }}, x, y);
    for (int i = 0; i < {{ num_out }}; i++) x[i] = y[i];
{% endfor %}
    for (int i = 0; i < POLICY_NUM_ACTIONS; i++) { /* fmin and fmax would hide NaN */
        action[i] = x[i];
        if (action[i] < policy_action_low[i]) action[i] = policy_action_low[i];
        if (action[i] > policy_action_high[i]) action[i] = policy_action_high[i];
    }
}

#endif
