% EIDORS reconstructions for eitbench, in GNU Octave.
%
%   octave --no-gui --quiet --norc eidors_bridge.m EIDORS-FOLDER
%
% says `eitbench: ready` when EIDORS has been started. Then every byte of its input asks for an answer
% to request.mat in the current folder. It says `eitbench: answered` once answer.mat is there, and ends
% with its input.
%
% request.mat holds (lengths in m, electrodes and nodes counted from 1, background 1 S/m):
%   algorithm          'noser', 'greit' or 'tv-pdipm'
%   parameters         struct, see `difference_model` and `greit`
%   nodes              N x 2
%   elements           K x 3 triangles
%   electrode_nodes    E x m nodes of each electrode, filled up with 0
%   contact_impedance  E x 1 [Ohm*m]
%   pattern            M x 4 src, sink, a, b: +1 A into src, -1 A out of sink, V = U(a) - U(b)
%   reference          M x 1 [V] the reference frame
%   frames             M x n [V]
% answer.mat gets
%   points             P x 2 where the contrast is estimated
%   values             P x n contrast

1;  % a file of commands, not of one function

function fmdl = forward_model (r)
  % EIDORS' forward model of the request: first-order triangles, complete electrode model.
  fmdl.name = 'eitbench';
  fmdl.nodes = r.nodes;
  fmdl.elems = r.elements;
  fmdl.boundary = find_boundary (r.elements);
  fmdl.gnd_node = 1;
  for k = 1:rows (r.electrode_nodes)
    nodes = r.electrode_nodes(k, :);
    fmdl.electrode(k).nodes = nodes(nodes > 0);
    fmdl.electrode(k).z_contact = r.contact_impedance(k);
  end
  fmdl.stimulation = stimulations (r.pattern, rows (r.electrode_nodes));
  fmdl.solve = @fwd_solve_1st_order;
  fmdl.system_mat = @system_mat_1st_order;
  fmdl.jacobian = @jacobian_adjoint;
  fmdl.normalize_measurements = 0;
  fmdl = eidors_obj ('fwd_model', fmdl);
end

function stimulation = stimulations (pattern, n_electrodes)
  % One stimulation for each run of rows with the same drive: the order of rows is kept.
  changes = any (diff (pattern(:, 1:2), 1, 1) != 0, 2);
  first = [1; find(changes) + 1];
  last = [first(2:end) - 1; rows(pattern)];
  for k = 1:numel (first)
    drive = pattern(first(k), 1:2);
    sense = pattern(first(k):last(k), 3:4);
    n = rows (sense);
    stimulation(k).stimulation = 'Amp';
    stimulation(k).stim_pattern = sparse (drive, [1, 1], [1, -1], n_electrodes, 1);
    stimulation(k).meas_pattern = ...
      sparse ([1:n, 1:n], [sense(:, 1)', sense(:, 2)'], [ones(1, n), -ones(1, n)], n, n_electrodes);
  end
end

function imdl = difference_model (r, fmdl)
  % EIDORS' inverse model for NOSER and TV: parameters.hyperparameter, .exponent, .iterations.
  imdl.name = 'eitbench';
  imdl.fwd_model = fmdl;
  imdl.reconst_type = 'difference';
  imdl.jacobian_bkgnd.value = 1;
  imdl.hyperparameter.value = r.parameters.hyperparameter;
  imdl.inv_solve.calc_solution_error = 0;
  if strcmp (r.algorithm, 'noser')
    imdl.solve = @inv_solve_diff_GN_one_step;
    imdl.RtR_prior = @prior_noser;
    imdl.prior_noser.exponent = r.parameters.exponent;
  else
    imdl.solve = @inv_solve_TV_pdipm;
    imdl.R_prior = @prior_TV;
    % Releases of EIDORS look in one or the other place.
    imdl.parameters.max_iterations = r.parameters.iterations;
    imdl.inv_solve.max_iterations = r.parameters.iterations;
    imdl.parameters.keep_iterations = 0;
  end
  imdl = eidors_obj ('inv_model', imdl);
end

function [points, values] = greit (r, fmdl)
  % GREIT in two dimensions: parameters.radius, .weight, .imgsz, .targets (3 x T: x, y, radius).
  % mk_GREIT_model wants a model in three dimensions; this is what it calls.
  targets = r.parameters.targets;
  [vh, vi] = simulate_movement (mk_image (fmdl, 1), targets);
  if columns (vi) != columns (targets)
    error ('eitbench: EIDORS left training targets out.');
  end
  low = min (r.nodes);
  high = max (r.nodes);
  n = r.parameters.imgsz;
  options.normalize = 0;
  options.desired_solution_fn = 'GREIT_desired_img_original';
  options.rec_model = mk_grid_model ([], linspace (low(1), high(1), n(1) + 1), ...
                                     linspace (low(2), high(2), n(2) + 1));
  options.rec_model.inside = [];  % all pixels
  matrix = calc_GREIT_RM (vh, vi, targets(1:2, :), r.parameters.radius, r.parameters.weight, options);
  values = matrix * (r.frames - r.reference);
  [x, y] = ndgrid (linspace (low(1), high(1), n(1)), linspace (low(2), high(2), n(2)));
  points = [x(:), y(:)];
end

function answer (r)
  % Reconstruct the frames of the request.
  fmdl = forward_model (r);
  if strcmp (r.algorithm, 'greit')
    [points, values] = greit (r, fmdl);
  else
    img = inv_solve (difference_model (r, fmdl), r.reference, r.frames);
    values = img.elem_data;
    points = (r.nodes(r.elements(:, 1), :) + r.nodes(r.elements(:, 2), :) ...
              + r.nodes(r.elements(:, 3), :)) / 3;
  end
  points = full (points);
  values = full (real (values));
  save ('-v7', 'answer.mat', 'points', 'values');
end

function say (word)
  printf ("eitbench: %s\n", word);
  fflush (stdout);
end

function reply = input (varargin)
  % EIDORS asks whether to compile again, of a terminal; the lines here are for us.
  reply = 'n';
end

try
  folder = argv (){end};
  run (fullfile (folder, 'startup.m'));
  eidors_msg ('log_level', 0);
  say ('ready');
  while ! isempty (fread (stdin, 1))  % fgetl would wait for the line after
    answer (load ('request.mat'));
    say ('answered');
  end
catch failure
  fprintf (stderr, "%s: %s\n", failure.stack(1).name, failure.message);
  exit (1);
end
