% The numbers of greit_eidors.json (from its first brace on), by EIDORS itself in GNU Octave:
%   EITBENCH_EIDORS=FOLDER_OF_EIDORS octave --quiet greit_eidors.m | sed -n '/^{/,$p' > greit_eidors.json
% EIDORS cuts the images that it evaluates out of a mesh; here they are made by a formula on its
% pixels instead, so that tests can make the same ones.
1;
function images = calc_slices(img)
  images = img.slices;
end

run(fullfile(getenv('EITBENCH_EIDORS'), 'startup.m'));
eidors_msg('log_level', 0);
% Octave's sum does not know the word 'all'.
code = fileread(which('eval_GREIT_fig_merit'));
code = strrep(code, "sum(img,'all')", 'sum(img(:))');
code = strrep(code, "sum(img.*qmi,'all')", 'sum((img.*qmi)(:))');
folder = tempname(); mkdir(folder);
file = fopen(fullfile(folder, 'eval_GREIT_fig_merit.m'), 'w'); fputs(file, code); fclose(file);
addpath(folder);

[x, y] = ndgrid(linspace(-1, 1, 32), linspace(-1, 1, 32));
target = [0 0.3 -0.55 0.1 -0.2; 0 0.2 0.4 -0.75 -0.35];
width = [0.2 0.15 0.25 0.12 0.3; 0.2 0.3 0.15 0.12 0.2];
offset = [0 -0.05 0.1 0 0.04];
for k = 1:5
  a = target(1, k) + offset(k); b = target(2, k) - offset(k);
  blob = exp(-((x - a) / width(1, k)).^2 - ((y - b) / width(2, k)).^2);
  ring = exp(-((x + b).^2 + (y - a).^2) / 0.1);
  image = blob - 0.1 * k * ring;
  image(x.^2 + y.^2 > 1) = NaN;
  img.slices(:, :, k) = image;
end
rim = linspace(0, 2 * pi, 65)'(1:64);
img.fwd_model = struct('type', 'fwd_model', 'nodes', [cos(rim), sin(rim)], 'boundary', [1:64]');
merit = eval_GREIT_fig_merit(img, [target; zeros(1, 5); 0.05 * ones(1, 5)]);

% A linear reconstruction by a formula; what it maps from and to is of no meaning.
imdl = mk_common_model('a2c0', 16);
m = (1:208)'; n = (1:64)';
imdl.solve = @solve_use_matrix;
imdl.solve_use_matrix.RM = cos(n * m') ./ (1 + abs(3 * n - m'));
imdl.hyperparameter.tgt_data.meas_t1 = 2 + sin(m);
imdl.hyperparameter.tgt_data.meas_t2 = 2 + sin(m) + 0.1 * exp(-((m - 90) / 20).^2);
figure_of_noise = calc_noise_figure(imdl);
area = get_elem_volume(imdl.fwd_model);

number = @(v) strjoin(arrayfun(@(a) sprintf('%.12g', a), v(:)', 'UniformOutput', false), ', ');
names = {'amplitude', 'position_error', 'resolution', 'shape_deformation', 'ringing'};
printf('{\n');
for k = 1:5
  printf(' "%s": [%s],\n', names{k}, number(merit(k, :)));
end
printf(' "noise_figure": %.12g,\n "area": [%s]\n}\n', figure_of_noise, number(area));
